//! Quotes in a table. A quoted cell may contain line breaks, as spreadsheets write them. A quote that opens a cell and is never closed
//! (`"hot`) is a plain character. Otherwise all rows up to the next quote would be part of its cell.

use crate::measurement::columns::mapping::Separator;
use crate::measurement::csv::number_text::without_unit;
use crate::measurement::issue::{ParseError, whole};
use crate::measurement::table::lines::{is_numeric, lines};
use std::borrow::Cow;

/// Maximum number of lines of one cell.
const MAX_LINES: usize = 50;
/// Maximum size of a cell with line breaks, bytes.
const MAX_CELL: usize = 64 * 1024;
/// If the text between two quotes on different lines has at least this many numbers or separators, it may be part of rows.
const PARTS_OF_A_ROW: usize = 3;
/// Replacement for an unclosed quote: the sign for inches and seconds, which looks the same.
const PLAIN_QUOTE: char = '\u{2033}';

/// A text in which each row is one line.
pub struct Rows<'t> {
    pub text: Cow<'t, str>,
    /// Whether the text differs from that of the file.
    pub is_changed: bool,
    pub numbers: LineNumbers,
}

/// The lines of a file for the rows of a text in which cells with line breaks are on one line.
#[derive(Clone, Debug, Default)]
pub struct LineNumbers {
    /// Rows, counted from 1, with the number of line breaks in the cells above them. From this row on, that number is added.
    breaks: Vec<(usize, usize)>,
}

impl LineNumbers {
    /// The line of the file for a row. Both are counted from 1.
    pub fn line_of_file(&self, row: usize) -> usize {
        let at = self.breaks.partition_point(|(from, _)| *from <= row);
        row + at.checked_sub(1).map_or(0, |at| self.breaks[at].1)
    }

    /// The row of a line of the file. A line within a cell is part of the row in which the cell begins.
    pub fn row_of_line(&self, line: usize) -> usize {
        let at = self
            .breaks
            .partition_point(|(from, more)| from + more <= line);
        let row = line - at.checked_sub(1).map_or(0, |at| self.breaks[at].1);
        match self.breaks.get(at) {
            Some((next, _)) => row.min(next - 1),
            None => row,
        }
    }
}

/// The separator of the cells, if known; otherwise any separator.
#[derive(Clone, Copy)]
struct Between(Option<Separator>);

impl Between {
    fn is(self, c: char) -> bool {
        match self.0 {
            Some(Separator::Spaces) => matches!(c, ' ' | '\t'),
            Some(separator) => c == char::from(separator.byte()),
            None => matches!(c, ',' | ';' | '|' | '\t'),
        }
    }

    /// Number of numbers and number of separators in a text. Spaces are not counted as separators, because they also occur between words.
    fn parts(self, text: &str) -> [usize; 2] {
        let words = text.split(|c| self.is(c) || c == ' ');
        let numbers = words
            .filter(|word| is_numeric(without_unit(word).0))
            .count();
        let separators = match self.0 {
            Some(Separator::Spaces) => 0,
            _ => text.chars().filter(|c| self.is(*c)).count(),
        };
        [numbers, separators]
    }
}

/// A quoted cell that ends on a later line.
enum OverLines<'t> {
    /// The end was found: its text on one line, the number of lines below the first, and the text after it.
    Cell(String, usize, &'t str),
    /// The quote is not closed.
    Stray,
    /// The quote may be closed, but rows may be in between: the number of lines below the first.
    Unclear(usize),
}

impl<'t> Rows<'t> {
    /// Replaces line breaks within quoted cells by spaces, and unclosed quotes by another character.
    ///
    /// # Errors
    /// `two_readings` if the text between two quotes may be a cell or rows; only if the separator is known.
    pub fn new(text: Cow<'t, str>, separator: Option<Separator>) -> Result<Self, ParseError> {
        if !text.contains('"') {
            return Ok(Self::unchanged(text));
        }
        let between = Between(separator);
        let (mut rows, mut numbers) = (String::with_capacity(text.len()), LineNumbers::default());
        let (mut at, mut row, mut more, mut is_changed) = (0, 1, 0, false);
        while at < text.len() {
            let begins = rows.len();
            let n_lines = match push_row(&mut rows, &text[at..], between) {
                Ok(n_lines) => n_lines,
                Err(n_lines) if separator.is_some() => {
                    return Err(unclear(row + more, row + more + n_lines));
                }
                Err(_) => {
                    rows.truncate(begins);
                    rows.extend(lines(&text[at..]).next().map(|line| line.text));
                    1
                }
            };
            let end = lines(&text[at..]).nth(n_lines - 1).map(|line| line.end);
            let end = at + end.unwrap_or(text.len() - at);
            let line = lines(&text[at..]).next();
            is_changed |= n_lines > 1 || line.is_some_and(|line| rows[begins..] != *line.text);
            (at, row) = (end, row + 1);
            if n_lines > 1 {
                more += n_lines - 1;
                numbers.breaks.push((row, more));
            }
            rows.push('\n');
        }
        Ok(match is_changed {
            true => Self {
                text: rows.into(),
                is_changed,
                numbers,
            },
            false => Self::unchanged(text),
        })
    }

    /// The text as it is.
    pub fn unchanged(text: Cow<'t, str>) -> Self {
        Self {
            text,
            is_changed: false,
            numbers: LineNumbers::default(),
        }
    }
}

fn unclear(from: usize, to: usize) -> ParseError {
    let detail = format!(
        "line {from} has a quote (\") that begins a cell, and line {to} one that would end it: the lines between may be rows, or a cell with line breaks. \
         Remove these quotes, or write the cell on one line"
    );
    whole("two_readings", detail)
}

/// Appends the first row of a text as one line. Returns its number of lines.
///
/// # Errors
/// The number of lines from the first one to a closing quote, if the text before this quote may be a cell or rows.
fn push_row(rows: &mut String, text: &str, between: Between) -> Result<usize, usize> {
    let mut below = lines(text);
    let mut rest = below.next().map_or("", |line| line.text);
    let mut n_lines = 1;
    loop {
        if let Some(inner) = rest.strip_prefix('"') {
            if let Some(end) = closing(inner) {
                rows.push_str(&rest[..end + 2]);
                rest = &rest[end + 2..];
            } else {
                let later = lines(text).skip(n_lines).map(|line| line.text);
                match over_lines(inner, later, between) {
                    OverLines::Cell(cell, n_more, after) => {
                        rows.push_str(&format!("\"{cell}\""));
                        (n_lines, rest) = (n_lines + n_more, after);
                    }
                    OverLines::Stray => {
                        rows.push(PLAIN_QUOTE);
                        rest = inner;
                    }
                    OverLines::Unclear(n_more) => return Err(n_lines - 1 + n_more),
                }
            }
        }
        let Some(end) = rest.find(|c| between.is(c)) else {
            rows.push_str(rest);
            return Ok(n_lines);
        };
        rows.push_str(&rest[..=end]);
        rest = &rest[end + 1..];
        // A quote also opens a cell after spaces: `"a", "b"`.
        let cell = match between.is(' ') {
            true => rest,
            false => rest.trim_start_matches(' '),
        };
        if cell.starts_with('"') {
            rest = cell;
        }
    }
}

/// The place of the quote that closes a cell. A pair of quotes stands for one quote.
fn closing(inner: &str) -> Option<usize> {
    let mut quotes = inner.match_indices('"').map(|(at, _)| at).peekable();
    while let Some(at) = quotes.next() {
        if quotes.next_if_eq(&(at + 1)).is_none() {
            return Some(at);
        }
    }
    None
}

/// Looks for the end of a quoted cell on later lines. A quote ends a cell if a separator or the end of its line follows.
fn over_lines<'t>(
    first: &str,
    later: impl Iterator<Item = &'t str>,
    between: Between,
) -> OverLines<'t> {
    let mut cell = first.to_owned();
    let mut parts = between.parts(first);
    for (at, line) in later.take(MAX_LINES).enumerate() {
        let end = closing(line);
        let inside = &line[..end.unwrap_or(line.len())];
        if cell.len() + inside.len() > MAX_CELL {
            break;
        }
        cell.push(' ');
        cell.push_str(inside);
        let [numbers, separators] = between.parts(inside);
        parts = [parts[0] + numbers, parts[1] + separators];
        if let Some(end) = end {
            let after = &line[end + 1..];
            let next = after.trim_start_matches(' ').chars().next();
            return match next.is_none_or(|c| between.is(c)) {
                true if parts.iter().all(|n| *n < PARTS_OF_A_ROW) => {
                    OverLines::Cell(cell, at + 1, after)
                }
                true => OverLines::Unclear(at + 1),
                false => OverLines::Stray,
            };
        }
    }
    OverLines::Stray
}

#[cfg(test)]
mod tests {
    use super::Rows;
    use crate::measurement::columns::mapping::Separator;

    fn read(text: &str, separator: Separator) -> Option<Vec<String>> {
        let rows = Rows::new(text.into(), Some(separator)).ok()?;
        Some(rows.text.lines().map(str::to_owned).collect())
    }

    fn rows(text: &str, separator: Separator) -> Vec<String> {
        read(text, separator).unwrap()
    }

    #[test]
    fn a_quote_that_closes_nothing_swallows_no_row() {
        let text = "a,b,c,note\n1,2,3,\"hot\n4,5,6,\n7,8,9,\"cold\n";
        assert_eq!(
            rows(text, Separator::Comma)[1..],
            ["1,2,3,″hot", "4,5,6,", "7,8,9,″cold"]
        );
        let text = "1,5 2,5 \"hot\n4,5 5,5 ok\n7,5 8,5 \"cold\n";
        assert_eq!(
            rows(text, Separator::Spaces),
            ["1,5 2,5 ″hot", "4,5 5,5 ok", "7,5 8,5 ″cold"]
        );
        // A quote after another separator opens nothing.
        let text = "1;a,\"b;\"c\n2;3;4\n";
        assert_eq!(rows(text, Separator::Semicolon), ["1;a,\"b;″c", "2;3;4"]);
    }

    #[test]
    fn what_may_be_a_cell_or_rows_is_refused() {
        for text in [
            "4.0mm;5.0mm;6.0mm;\"hot\n4.1mm;5.1mm;6.1mm;12\"\n",
            "1;2;3;\"\n4;5;6;\"\n",
            "Op;\"Meier\nx_mm;y_mm;z_mm;L 5\"\n1;2;3;4\n",
        ] {
            assert!(read(text, Separator::Semicolon).is_none(), "{text}");
            // Nothing is refused while the separator is unknown.
            assert!(Rows::new(text.into(), None).is_ok());
        }
    }

    #[test]
    fn a_line_break_within_a_cell_is_a_space() {
        let text =
            "\"J1\r\n[deg]\",\"X\n(mm)\",note\r\n1,2,\"warm, \"\"slow\"\"\n\nby hand\"\n3,4,\n";
        let found = Rows::new(text.into(), Some(Separator::Comma)).unwrap();
        let expected = "\"J1 [deg]\",\"X (mm)\",note\n1,2,\"warm, \"\"slow\"\"  by hand\"\n3,4,\n";
        assert_eq!(found.text, expected);
        let numbers = found.numbers;
        let lines: Vec<usize> = (1..=4).map(|row| numbers.line_of_file(row)).collect();
        assert_eq!(lines, [1, 4, 7, 8]);
        let rows: Vec<usize> = (1..=9).map(|line| numbers.row_of_line(line)).collect();
        assert_eq!(rows, [1, 1, 1, 2, 2, 2, 3, 4, 5]);
        // If the separator is a semicolon, a decimal comma is no separator.
        let text = "1;2;\"Wdh: 12,5 mm\nund 13,1 mm\"\n";
        assert_eq!(rows_of(text), ["1;2;\"Wdh: 12,5 mm und 13,1 mm\""]);
    }

    fn rows_of(text: &str) -> Vec<String> {
        rows(text, Separator::Semicolon)
    }

    #[test]
    fn quotes_that_are_closed_stay() {
        let text = "\"10,5\",\"say \"\"x\"\"\",5\",b\n";
        let found = Rows::new(text.into(), Some(Separator::Comma)).unwrap();
        assert!(found.text == text && !found.is_changed);
    }
}
