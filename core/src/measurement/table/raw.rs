//! A table in a file: its header and its rows. Values are not interpreted here.

use crate::measurement::columns::mapping::{ColumnRef, HeaderRow, Mapping, Separator, same_header};
use crate::measurement::columns::names::{TimeUnit, Unit};
use crate::measurement::conventions::Decimal;
use crate::measurement::issue::{ParseError, whole};
use crate::measurement::programs::ProgramRows;
use crate::measurement::table::endless_rows::refuse_endless_rows;
use crate::measurement::table::header::{
    found_header, separator_of_data, stated_frame_rate, stated_header, stated_length_unit,
    units_below, unnamed,
};
use crate::measurement::table::lines::{
    Line, cells, comment_mark, declared_separator, is_numeric, lines, with_tabs,
};
use crate::measurement::table::quotes::{LineNumbers, Rows};
use crate::measurement::table::text::{Encoding, Source};
use std::borrow::Cow;

/// Number of lines in which the header is searched. Instruments write about twenty lines of information above it.
const MAX_PREAMBLE: usize = 60;
/// Maximum number of columns of a table: a hundred times the usual number.
pub const MAX_COLUMNS: usize = 1000;

/// A table whose header has been found.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    /// The text from the first line after header and units.
    text: Cow<'a, str>,
    /// Encoding of the file.
    pub encoding: Encoding,
    /// The column separator.
    pub separator: Separator,
    /// The line of the header, counted from 1; none if all lines are data.
    pub header_line: Option<usize>,
    /// The cells of the header; empty texts if there is no header.
    pub header: Vec<String>,
    /// The cells of the line above the header, where a report may group its columns (Nominal, Measured).
    pub above: Vec<String>,
    /// The row of units below the header, one cell per column.
    pub units: Option<Vec<Option<Unit>>>,
    /// The unit of lengths that a line above the header states, as in files of OptiTrack.
    pub length_unit: Option<&'static str>,
    /// The frames per second that a line above the header states, as in files of Vicon.
    pub frame_rate: Option<TimeUnit>,
    /// The row on which `text` begins.
    first_line: usize,
    line_numbers: LineNumbers,
    /// Whether unclosed quotes were read as plain characters, or cells with line breaks were joined.
    pub plain_quotes: bool,
    /// Number of lines above the data that are neither header nor units.
    pub n_skipped_above: usize,
    /// Whether lines that begin with a comment mark are comments: as the mapping states, or true if at most one in five rows begins with a
    /// mark. `None`: such a line is a comment, except that one which looks like data is ambiguous.
    pub comments: Option<bool>,
    /// Whether the last line has no line break at its end. The file may have been cut off.
    pub is_open: bool,
    /// For a robot program: the lines of its points, and the points that are not read.
    pub program: Option<ProgramRows>,
}

/// A row of data.
#[derive(Clone, Debug)]
pub struct TableRow {
    /// The line on which the row begins, counted from 1.
    pub line: usize,
    /// Its cells.
    pub cells: csv::StringRecord,
}

/// The next row of a table.
#[derive(Debug)]
pub enum Next {
    /// A row of data.
    Row(TableRow),
    /// A blank row or a comment.
    Skipped,
    /// A line that cannot be read, or that may be data or a comment: line, code and detail.
    Bad(usize, &'static str, String),
}

impl<'a> Table<'a> {
    /// Finds the header and the separator, unless `mapping` states them.
    ///
    /// # Errors
    /// [`ParseError`] if the table is ambiguous or cannot be read.
    pub fn find(source: Source<'a>, mapping: &Mapping) -> Result<Self, ParseError> {
        let as_it_is = mapping.is_complete && !mapping.plain_quotes;
        if as_it_is || !source.text.contains('"') {
            return Self::of_rows(Rows::unchanged(source.text.clone()), source, mapping);
        }
        let mut mapping = mapping.clone();
        if mapping.separator.is_none() {
            // The places of cells depend on the separator, and the separator is found from the header, whose cells may contain line breaks.
            // The table is therefore found twice.
            let rows = Rows::new(source.text.clone(), None)?;
            let first = Self::of_rows(rows, source.clone(), &mapping)?;
            mapping.separator = Some(first.separator);
        }
        let rows = Rows::new(source.text.clone(), mapping.separator)?;
        Self::of_rows(rows, source, &mapping)
    }

    fn of_rows(rows: Rows<'a>, source: Source<'a>, mapping: &Mapping) -> Result<Self, ParseError> {
        let is_open = !source.text.ends_with(['\n', '\r']);
        let text: &str = &rows.text;
        let above: Vec<Line> = lines(text).take(MAX_PREAMBLE).collect();
        let first = above.iter().position(|line| !line.text.trim().is_empty());
        let declared = first.and_then(|at| declared_separator(above[at].text).map(|s| (at, s)));
        let separators: Vec<Separator> = match (mapping.separator, &declared, source.encoding) {
            (Some(separator), ..) => vec![separator],
            (None, Some((_, separator)), _) => vec![*separator],
            (None, None, Encoding::Xlsx | Encoding::Ods | Encoding::Program) => {
                vec![Separator::Tab]
            }
            (None, None, _) => Separator::ALL.into(),
        };
        let body = declared.map_or(0, |(at, _)| at + 1);
        let longest = above.iter().map(|line| line.text.len()).max();
        if longest > Some(64 * 1024) {
            refuse_endless_rows(text.as_bytes(), separators[0].byte())?;
        }
        let header = match mapping.header_row {
            Some(HeaderRow::None) => None,
            Some(HeaderRow::Line(line)) => {
                let line = rows.numbers.row_of_line(line);
                Some(stated_header(text, line, &separators, mapping)?)
            }
            None => found_header(&above, body, &separators, mapping)?,
        };
        let separator = match &header {
            Some(header) => header.separator,
            None => separator_of_data(&above[body..], &separators)?,
        };
        refuse_endless_rows(text.as_bytes(), separator.byte())?;
        let quoted = text.contains('"');
        if separator == Separator::Comma && mapping.decimal == Some(Decimal::Comma) && !quoted {
            let detail = "decimal commas were declared, so columns have to be separated by ';', tabs or spaces, not by ','";
            return Err(whole("wrong_separator", detail.into()));
        }
        let header_line = header.as_ref().map(|header| header.line);
        let names =
            header.map_or_else(|| unnamed(&above[body..], separator), |header| header.cells);
        if names.len() > MAX_COLUMNS {
            let detail = format!("{} columns; at most {MAX_COLUMNS} are read", names.len());
            return Err(whole("too_many_columns", detail));
        }
        let below = header_line.unwrap_or(body);
        let (units, begins) = units_below(text, below, separator, names.len());
        let n_skipped_above = match &source.program {
            Some(program) => program.n_other_lines,
            None => begins - usize::from(header_line.is_some()) - usize::from(units.is_some()),
        };
        let start = match begins {
            0 => 0,
            n => lines(text).nth(n - 1).map_or(text.len(), |line| line.end),
        };
        // A stated header may be below the lines in which headers are searched.
        let n_above = (header_line.unwrap_or(1) - 1).min(above.len());
        let length_unit = stated_length_unit(&above[..n_above]);
        let frame_rate = stated_frame_rate(&above[..n_above], &names);
        let over = header_line.and_then(|line| lines(text).nth(line.checked_sub(2)?));
        let over = over.map_or(vec![], |line| cells(line.text, separator));
        let header_line = header_line.map(|row| rows.numbers.line_of_file(row));
        let spaced = match separator {
            Separator::Spaces => {
                let spaced = lines(&text[start..]).map(|line| with_tabs(line.text) + "\n");
                Some(spaced.collect::<String>())
            }
            _ => None,
        };
        let comments = mapping.comments.or_else(|| {
            let rows = lines(&text[start..]).map(|line| line.text);
            has_commented_out_rows(rows, separator, names.len())
        });
        Ok(Self {
            line_numbers: rows.numbers,
            plain_quotes: rows.is_changed,
            text: match spaced {
                Some(spaced) => spaced.into(),
                None => tail(rows.text, start),
            },
            encoding: source.encoding,
            separator,
            header_line,
            header: names,
            above: over,
            units,
            length_unit,
            frame_rate,
            first_line: begins + 1,
            n_skipped_above,
            comments,
            is_open,
            program: source.program,
        })
    }

    /// Calls `take` with every row, including blank rows and comments, until `take` returns false.
    pub fn each_row(&self, mut take: impl FnMut(Next) -> bool) {
        let mut reader = csv::ReaderBuilder::new();
        let mut reader = reader
            .has_headers(false)
            .flexible(true)
            .delimiter(self.separator.byte())
            .from_reader(self.text.as_bytes());
        let mut cells = csv::StringRecord::new();
        loop {
            let read = reader.read_record(&mut cells);
            let line = self.line(self.first_line + self.lines_before(cells.position()));
            let next = match read {
                Ok(false) => return,
                Ok(true) => self.next(line, &cells),
                Err(error) => Next::Bad(line, "unreadable", error.to_string()),
            };
            if !take(next) {
                return;
            }
        }
    }

    /// The trimmed cells of the first rows: at most `n` of them, from the first `n_read` rows, blank ones and comments included.
    pub fn first_rows(&self, n: usize, n_read: usize) -> Vec<Vec<String>> {
        let (mut rows, mut seen) = (Vec::new(), 0);
        self.each_row(|next| {
            seen += 1;
            if let Next::Row(row) = next {
                let cells = row.cells.iter().map(|cell| cell.trim().to_owned());
                rows.push(cells.collect());
            }
            rows.len() < n && seen < n_read
        });
        rows
    }

    /// The line of the file for a row: for a point of a program, where it begins.
    fn line(&self, row: usize) -> usize {
        let of_program = self.program.as_ref();
        let begins = of_program.and_then(|program| program.lines.get(row - self.first_line));
        match begins {
            Some(line) => *line,
            None => self.line_numbers.line_of_file(row),
        }
    }

    /// Number of lines of the text above a record. The CSV reader counts empty lines before a record as part of the record; this is corrected.
    fn lines_before(&self, at: Option<&csv::Position>) -> usize {
        let Some(at) = at else { return 0 };
        let rest = self
            .text
            .as_bytes()
            .get(at.byte() as usize..)
            .unwrap_or(&[]);
        let empty = rest.iter().take_while(|byte| matches!(byte, b'\r' | b'\n'));
        at.line() as usize - 1 + empty.filter(|byte| **byte == b'\n').count()
    }

    fn next(&self, line: usize, cells: &csv::StringRecord) -> Next {
        if cells.iter().all(|cell| cell.trim().is_empty()) {
            return Next::Skipped;
        }
        let row = || {
            Next::Row(TableRow {
                line,
                cells: cells.clone(),
            })
        };
        match (cells.get(0).and_then(comment_mark), self.comments) {
            (None, _) | (Some(_), Some(false)) => row(),
            (Some(_), Some(true)) => Next::Skipped,
            (Some(mark), None) if !may_be_data(mark, cells.iter(), self.header.len()) => {
                Next::Skipped
            }
            (Some(mark), None) => {
                let detail = format!(
                    "line {line} begins with {mark:?} and has as many cells as a row: it may be a comment or data. State it \
                     in the column mapping: {{\"comments\": true}} (or false)"
                );
                Next::Bad(line, "two_readings", detail)
            }
        }
    }

    /// The index of a column.
    ///
    /// # Errors
    /// A description of what is wrong with the reference.
    pub fn place(&self, column: &ColumnRef) -> Result<usize, String> {
        match column {
            ColumnRef::Number(number) => {
                let is_there = (1..=self.header.len()).contains(number);
                is_there.then(|| number - 1).ok_or_else(|| {
                    format!(
                        "there is no column {number}; the table has {}",
                        self.header.len()
                    )
                })
            }
            ColumnRef::Header(text) => {
                let text = text.trim();
                let exact = self.header.iter().filter(|name| *name == text).count();
                let same = |name: &String| match exact {
                    0 => same_header(name, text),
                    _ => name == text,
                };
                let places: Vec<usize> = (0..self.header.len())
                    .filter(|i| same(&self.header[*i]))
                    .collect();
                match places[..] {
                    [place] => Ok(place),
                    // A quoted number refers to a column by its number only if the columns have no names.
                    [] => match text.parse() {
                        Ok(number) if self.header_line.is_none() => {
                            self.place(&ColumnRef::Number(number))
                        }
                        Ok(number) => {
                            let number: usize = number;
                            Err(format!(
                                "no column is called {text:?}; a column's number goes without quotes: {number}. The table has {}",
                                self.names()
                            ))
                        }
                        Err(_) => Err(format!(
                            "there is no column {text:?}; the table has {}",
                            self.names()
                        )),
                    },
                    _ => Err(format!(
                        "{} columns are called {text:?}: name the one that is meant by its number, counted from 1",
                        places.len()
                    )),
                }
            }
        }
    }

    /// The names of the columns, for messages. Names in another encoding, such as GBK, would be unreadable; the message then asks for
    /// UTF-8.
    pub fn names(&self) -> String {
        let names = listed(&self.header);
        match self.encoding == Encoding::Windows1252 && !names.is_ascii() {
            true => {
                names
                    + " (read as Windows-1252, because the file is not UTF-8: if these are not its names, save it as CSV in UTF-8)"
            }
            false => names,
        }
    }

    /// A column as a mapping refers to it: its name in quotes, or its number.
    pub fn reference(&self, place: usize) -> String {
        let name = self.header.get(place).filter(|name| !name.is_empty());
        let is_unique = |name: &&String| {
            let same = self
                .header
                .iter()
                .filter(|own| own.eq_ignore_ascii_case(name));
            same.count() == 1
        };
        match name.filter(is_unique) {
            Some(name) => format!("{name:?}"),
            None => (place + 1).to_string(),
        }
    }

    /// The name of a column for messages.
    pub fn name(&self, place: usize) -> String {
        match self.header.get(place).map(String::as_str) {
            None | Some("") => format!("column {}", place + 1),
            Some(name) => name.into(),
        }
    }
}

/// Whether a line that begins like a comment may be data: it has as many cells as a row, and at least two of them are numbers.
fn may_be_data<'c>(mark: &str, cells: impl Iterator<Item = &'c str>, n_columns: usize) -> bool {
    let cells: Vec<&str> = cells.collect();
    let first = cells.first().map_or("", |cell| cell.trim_start());
    let first = first.trim_start_matches(mark);
    let numbers = cells.iter().skip(1).filter(|cell| is_numeric(cell)).count();
    cells.len() >= n_columns.max(2) && numbers + usize::from(is_numeric(first)) >= 2
}

/// If there are at least this many other rows per row that begins like a comment, such rows were commented out.
const ROWS_PER_COMMENT: usize = 4;

/// True if a few rows begin like comments and most do not: somebody commented these rows out. None if there are no such rows, or many; in
/// the second case, the mark may be part of the points' names.
fn has_commented_out_rows<'r>(
    rows: impl Iterator<Item = &'r str>,
    separator: Separator,
    n_columns: usize,
) -> Option<bool> {
    let (mut n_marked, mut n_others) = (0, 0);
    for row in rows.filter(|row| !row.trim().is_empty()) {
        let Some(mark) = comment_mark(row) else {
            n_others += 1;
            continue;
        };
        let cells = cells(row, separator);
        if may_be_data(mark, cells.iter().map(String::as_str), n_columns) {
            n_marked += 1;
        }
    }
    (n_marked > 0 && ROWS_PER_COMMENT * n_marked <= n_others).then_some(true)
}

fn tail(text: Cow<'_, str>, start: usize) -> Cow<'_, str> {
    match text {
        Cow::Borrowed(text) => Cow::Borrowed(&text[start..]),
        Cow::Owned(text) => Cow::Owned(text[start..].to_owned()),
    }
}

/// The first names of a header, for a message.
fn listed(names: &[String]) -> String {
    let some: Vec<String> = names
        .iter()
        .filter(|name| !name.is_empty())
        .take(20)
        .map(|name| format!("{:?}", name.chars().take(60).collect::<String>()))
        .collect();
    match some.len() {
        0 => format!("{} columns without names", names.len()),
        _ => some.join(", "),
    }
}
