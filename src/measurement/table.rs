//! A table in a file: where its header is, what separates its columns, and its rows. Nothing here knows units.

use crate::measurement::column_mapping::{ColumnRef, HeaderRow, Mapping, Separator};
use crate::measurement::column_names::{Known, Unit, recognise, unit_alone};
use crate::measurement::conventions::Decimal;
use crate::measurement::csv_issue::{ParseError, whole};
use crate::measurement::csv_text::refuse_endless_rows;
use crate::measurement::table_text::{Encoding, Source};
use std::borrow::Cow;

/// Lines in which the header is searched: instruments write some twenty lines about themselves above it.
const MAX_PREAMBLE: usize = 60;
/// Lines that are looked at to tell separators apart where no header is known.
const SAMPLE: usize = 20;
/// Most columns of a table: a hundred times what one has.
pub const MAX_COLUMNS: usize = 1000;
/// How lines begin that are no data.
pub const COMMENT_MARKS: [&str; 4] = ["#", "%", "!", "//"];

/// A table whose header has been found.
#[derive(Clone, Debug)]
pub struct Table<'a> {
    /// From the first line after header and units.
    text: Cow<'a, str>,
    /// How the file wrote its characters.
    pub encoding: Encoding,
    /// What separates columns.
    pub separator: Separator,
    /// The line of the header, counted from 1; none where all lines are data.
    pub header_line: Option<usize>,
    /// The header's cells; empty texts where there is none.
    pub header: Vec<String>,
    /// The units that stand under the header, a cell per column.
    pub units: Option<Vec<Option<Unit>>>,
    /// The line on which `text` begins.
    first_line: usize,
    /// Lines above the data that are neither header nor units.
    pub n_skipped_above: usize,
    /// Whether lines that begin like comments are comments; not stated: only where they have not as many cells as the header.
    comments: Option<bool>,
}

/// A row of data.
#[derive(Clone, Debug)]
pub struct TableRow {
    /// The line on which it begins, counted from 1.
    pub line: usize,
    /// Its cells.
    pub cells: csv::StringRecord,
}

/// What the next row is.
#[derive(Debug)]
pub enum Next {
    /// Data.
    Row(TableRow),
    /// A blank row or a comment.
    Skipped,
    /// A line that may be either, or cannot be read.
    Bad(usize, &'static str, String),
}

/// A line, and the byte behind it.
struct Line<'t> {
    text: &'t str,
    end: usize,
}

fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let rest = text.get(at..).filter(|rest| !rest.is_empty())?;
        let length = rest.find(['\n', '\r']).unwrap_or(rest.len());
        let ending = match rest.as_bytes().get(length..length + 2) {
            Some(b"\r\n") => 2,
            _ => usize::from(length < rest.len()),
        };
        at += length + ending;
        Some(Line {
            text: &rest[..length],
            end: at,
        })
    })
}

/// The cells of one line.
pub(super) fn cells(line: &str, separator: Separator) -> Vec<String> {
    let spaced;
    let line = match separator {
        Separator::Spaces => {
            spaced = with_tabs(line);
            &spaced
        }
        _ => line,
    };
    let mut reader = csv::ReaderBuilder::new();
    let mut reader = reader
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .delimiter(separator.byte())
        .from_reader(line.as_bytes());
    let mut record = csv::StringRecord::new();
    match reader.read_record(&mut record) {
        Ok(true) => record.iter().map(str::to_owned).collect(),
        _ => vec![],
    }
}

/// A line with one tab in place of each run of spaces outside quotes.
fn with_tabs(line: &str) -> String {
    let mut found = String::with_capacity(line.len());
    let mut is_quoted = false;
    for c in line.trim().chars() {
        is_quoted ^= c == '"';
        match c {
            ' ' | '\t' if !is_quoted => {
                if !found.ends_with('\t') {
                    found.push('\t');
                }
            }
            c => found.push(c),
        }
    }
    found
}

fn comment_mark(line: &str) -> Option<&'static str> {
    let line = line.trim_start();
    COMMENT_MARKS.into_iter().find(|mark| line.starts_with(mark))
}

/// `sep=;` in the first line, as spreadsheets write and read it.
fn declared_separator(line: &str) -> Option<Separator> {
    let plain = line.trim_matches(['"', '\u{feff}', ' ']);
    let mark = plain.get(..4).filter(|start| start.eq_ignore_ascii_case("sep="))?;
    let rest = &plain[mark.len()..];
    Separator::parse(if rest == "\t" { rest } else { rest.trim() })
}

/// A header that was found.
struct Header {
    line: usize,
    separator: Separator,
    cells: Vec<String>,
    score: usize,
    is_comment: bool,
}

impl<'a> Table<'a> {
    /// Finds header and separator. `mapping` may state them.
    ///
    /// # Errors
    /// [`ParseError`] if there are two readings, or none.
    pub fn find(source: Source<'a>, mapping: &Mapping) -> Result<Self, ParseError> {
        let text: &str = &source.text;
        let above: Vec<Line> = lines(text).take(MAX_PREAMBLE).collect();
        let first = above.iter().position(|line| !line.text.trim().is_empty());
        let declared = first.and_then(|at| declared_separator(above[at].text).map(|s| (at, s)));
        let separators: Vec<Separator> = match (mapping.separator, &declared, source.encoding) {
            (Some(separator), ..) => vec![separator],
            (None, Some((_, separator)), _) => vec![*separator],
            (None, None, Encoding::Xlsx | Encoding::Ods | Encoding::Program) => vec![Separator::Tab],
            (None, None, _) => Separator::ALL.into(),
        };
        let body = declared.map_or(0, |(at, _)| at + 1);
        let longest = above.iter().map(|line| line.text.len()).max();
        if longest > Some(64 * 1024) {
            refuse_endless_rows(text.as_bytes(), separators[0].byte())?;
        }
        let header = match mapping.header_row {
            Some(HeaderRow::None) => None,
            Some(HeaderRow::Line(line)) => Some(stated_header(text, line, &separators, mapping)?),
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
        let names = header.map_or_else(
            || unnamed(&above[body..], separator),
            |header| header.cells,
        );
        if names.len() > MAX_COLUMNS {
            let detail = format!("{} columns; at most {MAX_COLUMNS} are read", names.len());
            return Err(whole("too_many_columns", detail));
        }
        let below = header_line.unwrap_or(body);
        let (units, begins) = units_below(text, below, separator, names.len());
        let n_skipped_above = begins - usize::from(header_line.is_some()) - usize::from(units.is_some());
        let start = match begins {
            0 => 0,
            n => lines(text).nth(n - 1).map_or(text.len(), |line| line.end),
        };
        Ok(Self {
            text: match separator {
                Separator::Spaces => lines(&text[start..])
                    .map(|line| with_tabs(line.text) + "\n")
                    .collect::<String>()
                    .into(),
                _ => tail(source.text, start),
            },
            encoding: source.encoding,
            separator,
            header_line,
            header: names,
            units,
            first_line: begins + 1,
            n_skipped_above,
            comments: mapping.comments,
        })
    }

    /// Calls `take` with every row, blank rows and comments included, until it returns false.
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
            let line = self.first_line + self.lines_before(cells.position());
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

    /// Lines of the text above a record. The reader counts empty lines in front of it as its own.
    fn lines_before(&self, at: Option<&csv::Position>) -> usize {
        let Some(at) = at else { return 0 };
        let rest = self.text.as_bytes().get(at.byte() as usize..).unwrap_or(&[]);
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
            (Some(mark), None) if !may_be_data(mark, cells, self.header.len()) => Next::Skipped,
            (Some(mark), None) => {
                let detail = format!(
                    "line {line} begins with {mark:?} and has as many cells as a row: it may be a comment or data. State \"comments\": true \
                     or false in ?columns= (--columns)"
                );
                Next::Bad(line, "two_readings", detail)
            }
        }
    }

    /// The place of a column.
    ///
    /// # Errors
    /// What is wrong with the reference, in words.
    pub(super) fn place(&self, column: &ColumnRef) -> Result<usize, String> {
        match column {
            ColumnRef::Number(number) => {
                let is_there = (1..=self.header.len()).contains(number);
                is_there
                    .then(|| number - 1)
                    .ok_or_else(|| format!("there is no column {number}; the table has {}", self.header.len()))
            }
            ColumnRef::Header(text) => {
                let text = text.trim();
                let exact = self.header.iter().filter(|name| *name == text).count();
                let same = |name: &String| match exact {
                    0 => super::column_mapping::same_header(name, text),
                    _ => name == text,
                };
                let places: Vec<usize> = (0..self.header.len())
                    .filter(|i| same(&self.header[*i]))
                    .collect();
                match places[..] {
                    [place] => Ok(place),
                    [] => Err(format!(
                        "there is no column {text:?}; the table has {}",
                        listed(&self.header)
                    )),
                    _ => Err(format!(
                        "{} columns are called {text:?}: name the one that is meant by its number, counted from 1",
                        places.len()
                    )),
                }
            }
        }
    }

    /// A column's name for people.
    pub fn name(&self, place: usize) -> String {
        match self.header.get(place).map(String::as_str) {
            None | Some("") => format!("column {}", place + 1),
            Some(name) => name.into(),
        }
    }
}

/// Whether a line that begins like a comment has as many cells as a row, and numbers among them.
fn may_be_data(mark: &str, cells: &csv::StringRecord, n_columns: usize) -> bool {
    let first = cells.get(0).unwrap_or("").trim_start().trim_start_matches(mark);
    let numbers = cells.iter().skip(1).filter(|cell| is_numeric(cell)).count();
    cells.len() >= n_columns.max(2) && numbers + usize::from(is_numeric(first)) >= 2
}

fn tail(text: Cow<'_, str>, start: usize) -> Cow<'_, str> {
    match text {
        Cow::Borrowed(text) => Cow::Borrowed(&text[start..]),
        Cow::Owned(text) => Cow::Owned(text[start..].to_owned()),
    }
}

/// The first names of a header, for a sentence.
pub(super) fn listed(names: &[String]) -> String {
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

fn score(cells: &[String], mapping: &Mapping) -> usize {
    let is_known = |cell: &&String| {
        mapping.names(cell)
            || match recognise(cell, None) {
                Known::Unknown => false,
                // words of titles, too
                Known::Key(_) | Known::Plain(_) => cells.len() > 2,
                _ => true,
            }
    };
    cells.iter().filter(is_known).count()
}

fn stated_header(
    text: &str,
    line: usize,
    separators: &[Separator],
    mapping: &Mapping,
) -> Result<Header, ParseError> {
    let Some(found) = line.checked_sub(1).and_then(|at| lines(text).nth(at)) else {
        let detail = format!("the mapping says that the header is on line {line}, which the file does not have");
        return Err(whole("no_header", detail));
    };
    let candidates = candidates(line, found.text, separators, mapping);
    let best = candidates.into_iter().reduce(|a, b| {
        match (b.score, b.cells.len()) > (a.score, a.cells.len()) {
            true => b,
            false => a,
        }
    });
    best.ok_or_else(|| whole("no_header", format!("line {line} is empty")))
}

/// A line as a header, split by each separator.
fn candidates(line: usize, text: &str, separators: &[Separator], mapping: &Mapping) -> Vec<Header> {
    let mark = comment_mark(text);
    let plain = mark.map_or(text, |mark| &text.trim_start()[mark.len()..]);
    let split = |separator: &Separator| {
        let cells = cells(plain, *separator);
        Header {
            line,
            separator: *separator,
            score: score(&cells, mapping),
            cells,
            is_comment: mark.is_some(),
        }
    };
    separators.iter().map(split).filter(|header| !header.cells.is_empty()).collect()
}

/// The line with the most cells that are known; a line that is no comment goes before one that is.
fn found_header(
    above: &[Line],
    body: usize,
    separators: &[Separator],
    mapping: &Mapping,
) -> Result<Option<Header>, ParseError> {
    let mut best: Option<Header> = None;
    let mut rival = None;
    for (at, line) in above.iter().enumerate().skip(body) {
        if line.text.len() > 64 * 1024 {
            break;
        }
        for header in candidates(at + 1, line.text, separators, mapping) {
            let rank = |header: &Header| (header.score, !header.is_comment);
            let Some(known) = &best else {
                if header.score > 0 {
                    best = Some(header);
                }
                continue;
            };
            if rank(&header) > rank(known) {
                (best, rival) = (Some(header), None);
            } else if rank(&header) == rank(known)
                && header.line == known.line
                && header.cells != known.cells
            {
                rival = Some(header.separator);
            }
        }
    }
    if let (Some(best), Some(rival)) = (&best, rival) {
        if best.score > 1 {
            let detail = format!(
                "line {} can be read with {:?} or with {:?} between its columns. State \"separator\" in ?columns= (--columns)",
                best.line,
                best.separator.as_str(),
                rival.as_str()
            );
            return Err(whole("two_readings", detail));
        }
    }
    if best.is_some() {
        return Ok(best.map(|header| widest(header, above, separators, mapping)));
    }
    if mapping.has_numbers() && mapping.columns.iter().all(|(_, c)| matches!(c, ColumnRef::Number(_))) {
        // numbers name columns with and without a header
        let separator = separator_of_data(&above[body..], separators)?;
        return Ok(first_named(above, body, separator));
    }
    let separator = separator_of_data(&above[body..], separators)?;
    Ok(first_named(above, body, separator))
}

/// With one cell known, a header is split by the separator that gives the most cells: of one known name all separators may make one cell.
fn widest(header: Header, above: &[Line], separators: &[Separator], mapping: &Mapping) -> Header {
    if header.score > 1 {
        return header;
    }
    let (line, score) = (header.line, header.score);
    let others = candidates(line, above[line - 1].text, separators, mapping);
    others
        .into_iter()
        .filter(|other| other.score == score)
        .fold(header, |best, other| match other.cells.len() > best.cells.len() {
            true => other,
            false => best,
        })
}

fn is_numeric(cell: &str) -> bool {
    cell.trim().replace(',', ".").parse::<f64>().is_ok()
}

/// The first line of a table without known names: a header if it has no number in it.
fn first_named(above: &[Line], body: usize, separator: Separator) -> Option<Header> {
    let (at, cells) = above
        .iter()
        .enumerate()
        .skip(body)
        .filter(|(_, line)| comment_mark(line.text).is_none())
        .map(|(at, line)| (at, cells(line.text, separator)))
        .find(|(_, cells)| cells.iter().filter(|cell| !cell.is_empty()).count() > 1)?;
    (!cells.iter().any(|cell| is_numeric(cell))).then_some(Header {
        line: at + 1,
        separator,
        cells,
        score: 0,
        is_comment: false,
    })
}

/// The separator with which rows have the same number of cells, more than one.
fn separator_of_data(above: &[Line], separators: &[Separator]) -> Result<Separator, ParseError> {
    let data: Vec<&Line> = above
        .iter()
        .filter(|line| !line.text.trim().is_empty() && comment_mark(line.text).is_none())
        .take(SAMPLE)
        .collect();
    let width = |separator: Separator| {
        let widths: Vec<usize> = data.iter().map(|line| cells(line.text, separator).len()).collect();
        let most = widths.iter().copied().max().unwrap_or(0);
        let alike = widths.iter().filter(|width| **width == most).count();
        (most > 1 && 2 * alike > widths.len()).then_some(most)
    };
    // Spaces stand within the cells of other separators, so they count only where nothing else does.
    let found: Vec<Separator> = separators
        .iter()
        .copied()
        .filter(|separator| *separator != Separator::Spaces && width(*separator).is_some())
        .collect();
    match found[..] {
        [separator] => Ok(separator),
        [] if width(Separator::Spaces).is_some() => Ok(Separator::Spaces),
        [] => Ok(separators[0]),
        _ => {
            let names: Vec<String> = found.iter().map(|s| format!("{:?}", s.as_str())).collect();
            let detail = format!(
                "columns may be separated by {}. State \"separator\" in ?columns= (--columns)",
                names.join(" or by ")
            );
            Err(whole("two_readings", detail))
        }
    }
}

/// Empty names for a table without a header.
fn unnamed(above: &[Line], separator: Separator) -> Vec<String> {
    let widths = above
        .iter()
        .filter(|line| comment_mark(line.text).is_none())
        .take(SAMPLE)
        .map(|line| cells(line.text, separator).len());
    vec![String::new(); widths.max().unwrap_or(0)]
}

/// A row of units under the header, and the number of lines above the data.
fn units_below(
    text: &str,
    header: usize,
    separator: Separator,
    n_columns: usize,
) -> (Option<Vec<Option<Unit>>>, usize) {
    if header == 0 {
        return (None, 0);
    }
    let next = lines(text)
        .enumerate()
        .skip(header)
        .find(|(_, line)| !line.text.trim().is_empty());
    let Some((at, line)) = next.filter(|(_, line)| line.text.len() < 64 * 1024) else {
        return (None, header);
    };
    let plain = comment_mark(line.text).map_or(line.text, |mark| &line.text.trim_start()[mark.len()..]);
    let found: Vec<String> = cells(plain, separator);
    let units: Vec<Option<Unit>> = found.iter().map(|cell| unit_alone(cell)).collect();
    let named = found.iter().zip(&units).filter(|(cell, _)| !cell.is_empty());
    let n_units = units.iter().flatten().count();
    if n_units >= 2 && named.count() == n_units && found.len() <= n_columns {
        return (Some(units), at + 1);
    }
    (None, header)
}
