//! Checks rows with fewer or more cells than the header. A missing or extra cell may have shifted the cells of other columns into the
//! columns that are read.

use crate::measurement::columns::mapping::Separator;
use crate::measurement::csv::number_text::without_unit;
use crate::measurement::csv::wrong_cell_count;
use crate::measurement::issue::{Issue, MAX_ISSUES};
use crate::measurement::table::lines::is_numeric;
use crate::measurement::table::{Table, TableRow};

/// A number with at least this many decimals looks measured. Remarks are numbers such as 5 or 21.5.
const MIN_DECIMALS: usize = 3;
/// A number after the last read column is suspicious if the column otherwise has texts: minimum number of texts per number.
const TEXTS_PER_NUMBER: usize = 4;
/// Minimum number of rows for recognising row numbers.
const MIN_NUMBERED: usize = 4;

/// Minimum number of rows with split numbers. They must also be at least half of all rows.
const MIN_SPLIT: usize = 3;

/// The range of columns that are read.
#[derive(Clone, Debug, Default)]
pub struct Ends {
    /// Number of columns up to the last one that every row must have: one that has a name or a meaning and that the mapping does not
    /// ignore.
    pub n_named: usize,
    /// Number of columns up to the last one that is read.
    pub n_read: usize,
    /// Whether the mapping ignores later columns of a table that is read for the first time.
    pub are_left_aside: bool,
    /// Whether every cell has a place of its own, as in workbooks. Missing cells at the end of a row are then empty.
    pub has_places: bool,
    /// Whether the last line has no line break at its end.
    pub is_open: bool,
    /// Whether the last column that is read has numbers. If it has texts, a shifted text would not be noticed.
    pub ends_with_number: bool,
    /// The columns of the position.
    pub positions: Vec<usize>,
    /// The first column that is read and its meaning, if it has joint values and was recognised by its name.
    pub first_joint: Option<(usize, String)>,
}

/// The refusal of a row whose cells may be shifted.
fn moved(row: usize, detail: String) -> Issue {
    Issue::new("wrong_cell_count", detail).in_row(row)
}

/// The last number that is read, in the most recent row.
struct Last {
    n_decimals: usize,
    /// Whether the row ends after it.
    is_at_end: bool,
}

/// What was found at the ends of the rows so far.
#[derive(Default)]
pub struct RowEnds {
    /// The first rows that are longer than the header, and the number of all of them.
    long: Vec<Issue>,
    n_long: usize,
    n_rows: usize,
    /// The first rows with a number that looks measured after the columns that are read; the number of rows with a number there, and of
    /// rows with a text there.
    numbers_behind: Vec<Issue>,
    n_numbers_behind: usize,
    n_texts_behind: usize,
    /// The first rows that end within the ignored columns, and whether any of these columns has a number.
    short: Vec<Issue>,
    has_number_behind: bool,
    /// The first row with a coordinate that may be split at a thousands separator, and the number of such rows.
    split: Option<Issue>,
    n_split: usize,
    last: Option<Last>,
    /// The number of decimals of the last number that is read, if it is the same in all rows above the last one.
    n_decimals: Option<usize>,
    are_decimals_unlike: bool,
    /// The last value of the first joint, as long as these values count the rows.
    counted: Option<i64>,
    is_not_counted: bool,
    /// Number of rows with decimals in the column after it.
    n_with_decimals: usize,
}

fn n_decimals(cell: &str) -> usize {
    let behind = cell.split_once(['.', ',']).map_or("", |(_, behind)| behind);
    behind.bytes().take_while(u8::is_ascii_digit).count()
}

/// Whether two cells may be one number with a thousands separator: one to three digits, then three digits with decimals.
fn is_split(whole: &str, rest: &str) -> bool {
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let whole = whole.trim_start_matches(['+', '-', '\u{2212}']);
    let is_whole = (1..=3).contains(&whole.len()) && digits(whole) && !whole.starts_with('0');
    let rest = rest.split_once(['.', ',']);
    is_whole
        && rest.is_some_and(|(group, behind)| {
            group.len() == 3 && digits(group) && !behind.is_empty() && digits(behind)
        })
}

impl RowEnds {
    /// Adds the next row. A row that ends early is refused, unless the mapping ignores the columns of the missing cells and these columns
    /// have no numbers. A remark that is a number could be read as a coordinate if another cell is missing.
    ///
    /// # Errors
    /// The detail, if the number of cells alone is a reason to refuse the row.
    pub fn take(
        &mut self,
        index: usize,
        row: &TableRow,
        table: &Table,
        ends: &Ends,
    ) -> Result<(), String> {
        let (n_cells, n_columns) = (row.cells.len(), table.header.len());
        let mut too_many = row.cells.iter().skip(n_columns);
        let detail = || wrong_cell_count(index, &row.cells, n_columns, table.separator.byte());
        if too_many.any(|cell| !cell.trim().is_empty()) {
            return Err(detail());
        }
        if ends.has_places {
            return Ok(());
        }
        if n_cells < ends.n_named {
            return Err(match n_cells < ends.n_read {
                true => detail(),
                false => detail() + &if_only_remarks_are_missing(table, ends),
            });
        }
        self.n_rows = index + 1;
        let cell = |at: usize| row.cells.get(at).unwrap_or("").trim();
        self.count(cell, ends);
        let is_split = |place: &&usize| is_split(cell(**place), cell(**place + 1));
        let is_possible = matches!(table.separator, Separator::Comma | Separator::Spaces);
        // A split number adds a cell.
        let is_possible = is_possible && n_cells > ends.n_read;
        if let Some(place) = ends.positions.iter().find(is_split).filter(|_| is_possible) {
            self.n_split += 1;
            let (whole, rest) = (cell(*place), cell(place + 1));
            self.split.get_or_insert_with(|| moved(index, format!(
                    "row {index}, column {}: {whole} stands in front of {rest}, as if they were one number with a separator of thousands, and so it is in half of the rows or more: \
                     write the numbers without such separators, or in quotes; if {whole} is the whole number, write it with decimals",
                    table.name(*place)
                ),
            ));
        }
        self.take_last(
            row,
            without_unit(cell(ends.n_read.saturating_sub(1))).0,
            ends,
        );
        let behind = cell(ends.n_read);
        let is_number_behind = is_numeric(behind);
        if ends.are_left_aside {
            let mut cells_behind = row.cells.iter().skip(ends.n_read);
            self.has_number_behind |= cells_behind.any(|cell| is_numeric(cell.trim()));
            if n_cells < n_columns && self.short.len() < MAX_ISSUES {
                self.short.push(moved(
                    index,
                    detail()
                        + ". The columns that are left aside have numbers, so a missing cell may have moved them: write every row with all its separators",
                ));
            }
        }
        self.n_long += usize::from(n_cells > n_columns);
        if n_cells > n_columns && is_number_behind && self.long.len() < MAX_ISSUES {
            self.long.push(moved(index, detail()));
        }
        self.n_texts_behind += usize::from(!is_number_behind && !behind.is_empty());
        self.n_numbers_behind += usize::from(is_number_behind);
        let looks_measured = is_number_behind && n_decimals(behind) >= MIN_DECIMALS;
        if looks_measured && self.numbers_behind.len() < MAX_ISSUES {
            let name = table.name(ends.n_read);
            self.numbers_behind.push(moved(index, format!(
                "row {index}, column {name}: a number that looks like those of the column in front stands among texts: has a cell a separator in it, so that all behind it have \
                 moved? Put that cell in quotes; if the number is a remark, put it in words, or remove the column"
            )));
        }
        Ok(())
    }

    fn take_last(&mut self, row: &TableRow, cell: &str, ends: &Ends) {
        let last = Last {
            n_decimals: n_decimals(cell),
            is_at_end: row.cells.len() == ends.n_read && ends.ends_with_number,
        };
        if let Some(before) = self.last.replace(last) {
            let alike = *self.n_decimals.get_or_insert(before.n_decimals);
            self.are_decimals_unlike |= alike != before.n_decimals;
        }
    }

    fn count<'c>(&mut self, cell: impl Fn(usize) -> &'c str, ends: &Ends) {
        let first = ends.first_joint.as_ref().map(|(first, _)| *first);
        let Some(first) = first.filter(|_| !self.is_not_counted) else {
            return;
        };
        let number = cell(first).parse::<i64>().ok();
        let next = self
            .counted
            .and_then(|before| before.checked_add(1))
            .or(number);
        self.is_not_counted = number.is_none() || number != next;
        self.counted = number;
        self.n_with_decimals += usize::from(n_decimals(cell(first + 1)) > 0);
    }

    /// Refuses rows whose cells may be shifted.
    ///
    /// If all rows are longer than the header, they have a separator at their end. If only some are, they have a separator within a cell.
    pub fn refused(&mut self, table: &Table, ends: &Ends) -> Vec<Issue> {
        let mut found = Vec::new();
        if self.n_long < self.n_rows {
            found.append(&mut self.long);
        }
        if TEXTS_PER_NUMBER * self.n_numbers_behind <= self.n_texts_behind && ends.ends_with_number
        {
            found.append(&mut self.numbers_behind);
        }
        if self.has_number_behind {
            found.append(&mut self.short);
        }
        found.extend(self.cut_off(table, ends));
        if self.n_split >= MIN_SPLIT && 2 * self.n_split >= self.n_rows {
            found.extend(self.split.take());
        }
        found.truncate(MAX_ISSUES);
        found.extend(self.row_numbers(table, ends));
        found
    }

    /// Refuses joint values that number the rows: the rows then have one more cell at their beginning than the header has names, as R
    /// writes them.
    fn row_numbers(&self, table: &Table, ends: &Ends) -> Option<Issue> {
        let (first, means) = ends.first_joint.as_ref().filter(|_| !self.is_not_counted)?;
        let are_few = self.n_rows < MIN_NUMBERED || 2 * self.n_with_decimals < self.n_rows;
        let name = table.name(*first);
        let detail = format!(
            "column {name} numbers the rows, and the column behind it has decimals: so each row may have one cell more in front than the header has names. Write a name \
             for it into the header; if these are joint values, say so in the column mapping: {{{means:?}: {name:?}}}"
        );
        let issue = Issue::new("two_readings", detail).in_column(name);
        (!are_few).then_some(issue)
    }

    /// Refuses the last row of a file without a final line break if its last number has fewer decimals than all others: the file may have
    /// been cut off.
    fn cut_off(&self, table: &Table, ends: &Ends) -> Option<Issue> {
        let last = self.last.as_ref().filter(|last| last.is_at_end)?;
        let alike = self.n_decimals.filter(|_| !self.are_decimals_unlike)?;
        let row = self.n_rows - 1;
        let is_cut = ends.is_open && row >= MIN_NUMBERED && last.n_decimals < alike;
        is_cut.then(|| moved(row, format!(
                "row {row}, column {}: the number has {} decimals and all others have {alike}, and the file has no line break at its end: was it cut off? \
                 If the row is whole, write a line break behind it",
                table.name(ends.n_read.saturating_sub(1)),
                last.n_decimals
            ),
        ))
    }
}

/// Advice for a row whose missing cells may all belong to columns that are not read.
fn if_only_remarks_are_missing(table: &Table, ends: &Ends) -> String {
    let behind = ends.n_read..ends.n_named;
    let columns: Vec<String> = behind.map(|place| table.reference(place)).collect();
    format!(
        ". If only cells behind {} are missing, leave their columns aside in the column mapping: {{\"ignore\": [{}]}}",
        table.name(ends.n_read.saturating_sub(1)),
        columns.join(", ")
    )
}
