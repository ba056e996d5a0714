//! Quotes in a table. A quoted cell may hold line breaks, as spreadsheets write them. A quote that opens a cell and closes nothing (`"hot`, or `"` for
//! "as above") is a plain character: otherwise all rows down to the next quote would be part of its cell.

use crate::measurement::table_lines::{Line, is_numeric, lines};
use std::borrow::Cow;

/// Maximum number of lines of one cell.
const MAX_LINES: usize = 50;
/// Number of numbers with which the text between two quotes on different lines is part of rows, and no cell.
const NUMBERS_OF_A_ROW: usize = 3;
/// The character in place of a quote that closes nothing: the sign for inches and seconds, which looks the same.
const PLAIN_QUOTE: char = '\u{2033}';

/// A text in which each row is one line.
pub(super) struct Rows<'t> {
    pub(super) text: Cow<'t, str>,
    /// The line of the file on which each of these lines begins, counted from 1; none if they are the same.
    pub(super) starts: Option<Vec<usize>>,
}

impl<'t> Rows<'t> {
    /// Replaces line breaks within quoted cells by spaces, and quotes that close nothing by another character.
    pub(super) fn new(text: Cow<'t, str>) -> Self {
        if !text.contains('"') {
            return Self { text, starts: None };
        }
        let all: Vec<Line> = lines(&text).collect();
        let (mut rows, mut starts, mut at) = (String::with_capacity(text.len()), vec![], 0);
        while at < all.len() {
            starts.push(at + 1);
            at += push_row(&mut rows, &all[at..]);
            rows.push('\n');
        }
        let is_same = starts.len() == all.len();
        Self {
            text: rows.into(),
            starts: (!is_same).then_some(starts),
        }
    }

    /// The line of the file for a line of this text. Both are counted from 1.
    pub(super) fn line_of_file(&self, line: usize) -> usize {
        let start = self.starts.as_ref().and_then(|starts| starts.get(line - 1));
        start.copied().unwrap_or(line)
    }

    /// The line of this text for a line of the file.
    pub(super) fn line_of_text(&self, line: usize) -> usize {
        match &self.starts {
            Some(starts) => starts.partition_point(|start| *start <= line),
            None => line,
        }
    }
}

fn is_separator(c: char, spaces: bool) -> bool {
    matches!(c, ',' | ';' | '|' | '\t') || spaces && c == ' '
}

/// Writes the first row of these lines as one line. Returns its number of lines.
fn push_row(rows: &mut String, below: &[Line]) -> usize {
    let mut n_lines = 1;
    let mut rest = below[0].text;
    // Names may contain spaces, so spaces separate cells only if nothing else does.
    let spaces = !rest.contains(|c| is_separator(c, false));
    loop {
        if let Some(inner) = rest.strip_prefix('"') {
            if let Some(end) = closing(inner) {
                rows.push_str(&rest[..end + 2]);
                rest = &rest[end + 2..];
            } else if let Some((cell, n_more, after)) = over_lines(inner, &below[n_lines..], spaces)
            {
                rows.push_str(&format!("\"{cell}\""));
                (n_lines, rest) = (n_lines + n_more, after);
            } else {
                rows.push(PLAIN_QUOTE);
                rest = inner;
            }
        }
        let Some(end) = rest.find(|c| is_separator(c, spaces)) else {
            rows.push_str(rest);
            return n_lines;
        };
        rows.push_str(&rest[..=end]);
        rest = &rest[end + 1..];
    }
}

/// The place of the quote that closes a cell. Two quotes stand for one.
fn closing(inner: &str) -> Option<usize> {
    let mut quotes = inner.match_indices('"').map(|(at, _)| at).peekable();
    while let Some(at) = quotes.next() {
        if quotes.next_if_eq(&(at + 1)).is_none() {
            return Some(at);
        }
    }
    None
}

/// A quoted cell that ends on a later line: its text on one line, the number of lines below the first, and the text after it. None if what is between
/// the quotes has the numbers of a row, or if the quote that would close it does not end a cell.
fn over_lines<'t>(
    first: &str,
    below: &[Line<'t>],
    spaces: bool,
) -> Option<(String, usize, &'t str)> {
    let mut cell = first.to_owned();
    for (at, line) in below.iter().take(MAX_LINES).enumerate() {
        if n_numbers(&cell) >= NUMBERS_OF_A_ROW {
            return None;
        }
        cell.push(' ');
        let Some(end) = closing(line.text) else {
            cell.push_str(line.text);
            continue;
        };
        cell.push_str(&line.text[..end]);
        let after = &line.text[end + 1..];
        let next = after.trim_start_matches(' ').chars().next();
        let ends_cell = next.is_none_or(|c| is_separator(c, spaces));
        return (ends_cell && n_numbers(&cell) < NUMBERS_OF_A_ROW).then_some((cell, at + 1, after));
    }
    None
}

fn n_numbers(text: &str) -> usize {
    let words = text.split(|c| is_separator(c, true));
    words.filter(|word| is_numeric(word)).count()
}

#[cfg(test)]
mod tests {
    use super::Rows;

    fn rows(text: &str) -> Vec<String> {
        let rows = Rows::new(text.into());
        rows.text.lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_quote_that_closes_nothing_swallows_no_row() {
        let text = "a,b,c,note\n1,2,3,\"hot\n4,5,6,\n7,8,9,\"cold\n";
        assert_eq!(rows(text)[1..], ["1,2,3,″hot", "4,5,6,", "7,8,9,″cold"]);
        // In the first column, in all rows, and a quote that ends a cell of a later row.
        let text = "\"a;1;2;3\n\"b;4;5;6\nc\";7;8;9\n";
        assert_eq!(rows(text), ["″a;1;2;3", "″b;4;5;6", "c\";7;8;9"]);
        assert_eq!(
            rows("1\t2\t3\t\"\n4\t5\t6\t\"\n"),
            ["1\t2\t3\t″", "4\t5\t6\t″"]
        );
        assert_eq!(rows("1 2 3 \"x\n4 5 6 y\"\n"), ["1 2 3 ″x", "4 5 6 y\""]);
    }

    #[test]
    fn a_line_break_within_a_cell_is_a_space() {
        let text =
            "\"J1\r\n[deg]\",\"X\n(mm)\",note\r\n1,2,\"warm, \"\"slow\"\"\n\nby hand\"\n3,4,\n";
        let found = Rows::new(text.into());
        let expected = "\"J1 [deg]\",\"X (mm)\",note\n1,2,\"warm, \"\"slow\"\"  by hand\"\n3,4,\n";
        assert_eq!(found.text, expected);
        assert_eq!(found.line_of_file(3), 7);
        assert_eq!(found.line_of_text(7), 3);
        assert_eq!(found.line_of_text(2), 1);
    }

    #[test]
    fn quotes_that_are_closed_stay() {
        let text = "\"10,5\",\"say \"\"x\"\"\",5\",b\n";
        assert_eq!(Rows::new(text.into()).text, text);
    }
}
