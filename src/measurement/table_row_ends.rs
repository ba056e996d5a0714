//! Rows with fewer or more cells than the header: whether a cell that is missing or too many has moved the cells of other columns into those that are read.

use crate::measurement::csv::{CELL_IS_MISSING, wrong_cell_count};
use crate::measurement::csv_issue::{Issue, MAX_ISSUES};
use crate::measurement::number_text::without_unit;
use crate::measurement::table::{Table, TableRow};
use crate::measurement::table_lines::is_numeric;

/// Number of short rows from which on they are a habit of the file, and not a cell that is missing.
const MIN_SHORT: usize = 3;
/// Number of decimals from which on a number looks measured. Remarks are numbers such as 5 or 21.5.
const MIN_DECIMALS: usize = 3;
/// A short row has an unusual number of decimals if less than one in so many rows has as few.
const ROWS_PER_UNUSUAL: usize = 20;
/// Number of texts for each number among them that looks as if it belonged into the column in front.
const TEXTS_PER_NUMBER: usize = 4;
/// Number of rows from which on whole numbers one after the other number the rows.
const MIN_NUMBERED: usize = 4;

/// Where the cells that are read stand.
#[derive(Clone, Debug, Default)]
pub(super) struct Ends {
    /// Number of columns with a name or a meaning.
    pub(super) n_named: usize,
    /// Number of columns up to the last one that is read.
    pub(super) n_read: usize,
    /// Whether missing cells at the end of a row are empty ones: in workbooks, where each cell has a place of its own.
    pub(super) has_places: bool,
    /// Whether the last line has no line end.
    pub(super) is_open: bool,
    /// Whether the last column that is read has numbers. A text that moves into another column is not noticed.
    pub(super) ends_with_number: bool,
    /// The first column that is read and its meaning, if it has joint values and was found by its name.
    pub(super) first_joint: Option<(usize, String)>,
}

/// A row whose cells may have moved.
struct Moved {
    row: usize,
    line: usize,
    n_cells: usize,
    /// The cell behind those that are read, if it is a number.
    behind: Option<Number>,
    /// What is wrong, unless the row is short.
    detail: String,
}

/// The number of decimals and the value of a cell.
#[derive(Clone, Copy)]
struct Number {
    decimals: u8,
    value: f64,
}

impl Number {
    fn new(cell: &str) -> Self {
        let behind = cell.split_once(['.', ',']).map_or("", |(_, behind)| behind);
        let digits = behind.bytes().take_while(u8::is_ascii_digit).take(255);
        Self {
            decimals: digits.count() as u8,
            value: cell.replace(',', ".").parse().unwrap_or(f64::NAN),
        }
    }
}

/// The ends of the rows that were read so far.
#[derive(Default)]
pub(super) struct RowEnds {
    short: Vec<Moved>,
    /// The first rows that are longer than the header, and the number of all of them.
    long: Vec<Moved>,
    n_long: usize,
    n_rows: usize,
    /// The first rows of the header's length with a number behind those that are read, their number, and that of rows with a text there.
    numbers_behind: Vec<Moved>,
    n_numbers_behind: usize,
    n_texts_behind: usize,
    /// Of rows that are not short: the number of columns at the end, behind those that are read, in which none has a number.
    texts_behind: Option<usize>,
    /// Whether one of them has no number in the column behind those that are read.
    has_text_behind: bool,
    /// For each row, the last number that is read.
    last: Vec<Number>,
    /// Of the last row: its line, and whether it ends behind the last column that is read.
    last_line: usize,
    ends_behind_last: bool,
    /// The first joint value, as long as it is a whole number that counts the rows.
    counted: Option<i64>,
    is_not_counted: bool,
    /// Number of rows with decimals in the column behind it.
    n_with_decimals: usize,
}

impl RowEnds {
    /// Takes the next row.
    ///
    /// # Errors
    /// The detail, if its number of cells alone refuses it.
    pub(super) fn take(
        &mut self,
        index: usize,
        row: &TableRow,
        table: &Table,
        ends: &Ends,
    ) -> Result<(), String> {
        let n_columns = table.header.len();
        let mut too_many = row.cells.iter().skip(n_columns);
        let detail = || wrong_cell_count(index, &row.cells, n_columns, table.separator.byte());
        if too_many.any(|cell| !cell.trim().is_empty()) {
            return Err(detail());
        }
        if ends.has_places {
            return Ok(());
        }
        self.n_rows = index + 1;
        let cell = |at: usize| row.cells.get(at).unwrap_or("").trim();
        self.count(cell, ends);
        let (last, _) = without_unit(cell(ends.n_read.saturating_sub(1)));
        self.last.push(Number::new(last));
        self.last_line = row.line;
        self.ends_behind_last = row.cells.len() == ends.n_read && ends.ends_with_number;
        let n_cells = row.cells.len();
        let behind = cell(ends.n_read);
        let behind = is_numeric(behind).then(|| Number::new(behind));
        let moved = |detail: String| Moved {
            row: index,
            line: row.line,
            n_cells,
            behind,
            detail,
        };
        if n_cells < ends.n_named {
            if n_cells < ends.n_read || !ends.ends_with_number {
                return Err(detail());
            }
            self.short.push(moved(String::new()));
            return Ok(());
        }
        self.n_long += usize::from(n_cells > n_columns);
        if n_cells > n_columns && behind.is_some() && self.long.len() < MAX_ISSUES {
            self.long.push(moved(detail()));
        }
        self.n_texts_behind += usize::from(behind.is_none() && !cell(ends.n_read).is_empty());
        self.n_numbers_behind += usize::from(behind.is_some());
        if behind.is_some() && self.numbers_behind.len() < MAX_ISSUES {
            let name = table.name(ends.n_read);
            self.numbers_behind.push(moved(format!(
                "row {index}, column {name}: a number that looks like those of the column in front stands among texts: has a cell a separator in it, so that all behind it have \
                 moved? Put that cell in quotes; if the number is a remark, put it in words, or remove the column"
            )));
        }
        let places = (ends.n_read..ends.n_named).rev();
        let n_texts = places.take_while(|at| !is_numeric(cell(*at))).count();
        self.texts_behind = Some(self.texts_behind.unwrap_or(n_texts).min(n_texts));
        self.has_text_behind |= behind.is_none();
        Ok(())
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
        self.n_with_decimals += usize::from(Number::new(cell(first + 1)).decimals > 0);
    }

    /// Refuses rows whose cells may have moved. Each issue has its line.
    ///
    /// Of a row that ends early, only texts may be missing: no row has a number in these columns. If another cell is missing, a remark has moved into the last
    /// column that is read. A remark that is a text is refused there; one that is a number has few decimals, or a value that the column does not have. One or
    /// two short rows are no habit of the file. The last row of a file without a line end may be cut off within a number.
    ///
    /// Rows that are longer than the header all alike have a separator at their end. A longer row among others has a separator within a cell.
    pub(super) fn refused(&mut self, table: &Table, ends: &Ends) -> Vec<(Issue, Option<usize>)> {
        let short = std::mem::take(&mut self.short);
        let n_texts = self.texts_behind.unwrap_or(0);
        let is_habit = short.len() >= MIN_SHORT;
        let column = LastColumn::new(&self.last);
        let last = |moved: &Moved| self.last.get(moved.row).copied();
        let is_moved = |moved: &Moved| {
            let is_cut = ends.is_open && moved.row + 1 == self.n_rows;
            is_cut
                || !is_habit
                || ends.n_named - moved.n_cells > n_texts
                || moved.behind.is_some() == self.has_text_behind
                || !last(moved).is_some_and(|own| column.has(own, own))
        };
        let is_short = |moved: Moved| Moved {
            detail: format!(
                "row {} has {} cells, the header has {}; {CELL_IS_MISSING}. If nothing is missing, end the row with a separator for each empty cell, or remove the \
                 columns behind {}",
                moved.row,
                moved.n_cells,
                table.header.len(),
                table.name(ends.n_read.saturating_sub(1))
            ),
            ..moved
        };
        let short = short.into_iter().filter(is_moved).take(MAX_ISSUES);
        let mut found: Vec<Moved> = short.map(is_short).collect();
        if self.n_long < self.n_rows {
            found.append(&mut self.long);
        }
        if TEXTS_PER_NUMBER * self.n_numbers_behind <= self.n_texts_behind && ends.ends_with_number
        {
            let is_moved = |moved: &Moved| {
                let own = last(moved).zip(moved.behind);
                own.is_some_and(|(own, behind)| column.has(behind, own))
            };
            let numbers = std::mem::take(&mut self.numbers_behind);
            found.extend(numbers.into_iter().filter(is_moved));
        }
        found.extend(self.cut_off(table, ends));
        let issue = |moved: Moved| {
            let issue = Issue {
                row: Some(moved.row),
                column: None,
                code: "wrong_cell_count",
                detail: moved.detail,
            };
            (issue, Some(moved.line))
        };
        let found = found.into_iter().take(MAX_ISSUES).map(issue);
        found.chain(self.row_numbers(table, ends)).collect()
    }

    /// Refuses joint values that number the rows. The rows have a cell more in front than the header has names, as R writes them.
    fn row_numbers(&self, table: &Table, ends: &Ends) -> Option<(Issue, Option<usize>)> {
        let (first, means) = ends.first_joint.as_ref().filter(|_| !self.is_not_counted)?;
        let are_few = self.n_rows < MIN_NUMBERED || 2 * self.n_with_decimals < self.n_rows;
        let name = table.name(*first);
        let detail = format!(
            "column {name} numbers the rows, and the column behind it has decimals: so each row may have one cell more in front than the header has names. Write a name \
             for it into the header; if these are joint values, say so in the column mapping: {{{means:?}: {name:?}}}"
        );
        let issue = Issue {
            row: None,
            column: Some(name),
            code: "two_readings",
            detail,
        };
        (!are_few).then_some((issue, None))
    }

    /// The last row of a file without a line end, if its last number has fewer decimals than all others.
    fn cut_off(&self, table: &Table, ends: &Ends) -> Option<Moved> {
        let (last, others) = self.last.split_last().filter(|_| ends.is_open)?;
        let (own, decimals) = (last.decimals, others.first()?.decimals);
        let are_alike = others.iter().all(|other| other.decimals == decimals);
        let are_few = others.len() < MIN_NUMBERED;
        let name = table.name(ends.n_read.saturating_sub(1));
        let row = others.len();
        let is_cut = are_alike && !are_few && own < decimals && self.ends_behind_last;
        is_cut.then(|| Moved {
            row,
            line: self.last_line,
            n_cells: ends.n_read,
            behind: None,
            detail: format!(
                "row {row}, column {name}: the number has {own} decimals and all others have {decimals}, and the file has no line break at its end: was it cut off? \
                 If the row is whole, write a line break behind it"
            ),
        })
    }
}

/// The numbers in the last column that is read.
struct LastColumn {
    n_rows: usize,
    /// For each number of decimals, how many have as many or fewer.
    n_with: Vec<usize>,
    /// The two least and the two largest values.
    least: [f64; 2],
    largest: [f64; 2],
}

impl LastColumn {
    fn new(numbers: &[Number]) -> Self {
        let mut n_with = vec![0; 256];
        for number in numbers {
            n_with[usize::from(number.decimals)] += 1;
        }
        for decimals in 1..n_with.len() {
            n_with[decimals] += n_with[decimals - 1];
        }
        let mut values: Vec<f64> = numbers.iter().map(|number| number.value).collect();
        values.retain(|value| !value.is_nan());
        values.sort_by(f64::total_cmp);
        let at = |place: Option<usize>| place.and_then(|at| values.get(at)).copied();
        let value = |place: Option<usize>| at(place).unwrap_or(f64::NAN);
        let n = values.len();
        Self {
            n_rows: numbers.len(),
            n_with,
            least: [value(Some(0)), value(Some(1))],
            largest: [value(n.checked_sub(1)), value(n.checked_sub(2))],
        }
    }

    /// Whether a number looks like the others of the column: as many decimals, and a value near theirs. `own` is the number of its row, which is none of the others.
    fn has(&self, number: Number, own: Number) -> bool {
        let other = |two: [f64; 2]| two[usize::from(two[0] == own.value)];
        let (least, largest) = (other(self.least), other(self.largest));
        let apart = largest - least;
        let n_alike = self.n_with[usize::from(number.decimals)];
        usize::from(number.decimals) >= MIN_DECIMALS
            && ROWS_PER_UNUSUAL * n_alike >= self.n_rows
            && (least - apart..=largest + apart).contains(&number.value)
    }
}
