//! Lines of a table and their cells.

use crate::measurement::columns::mapping::Separator;

/// Prefixes of comment lines.
pub const COMMENT_MARKS: [&str; 4] = ["#", "%", "!", "//"];

/// A line of a text, and the offset of the byte after its line ending.
pub struct Line<'t> {
    pub text: &'t str,
    pub end: usize,
}

pub fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
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
pub fn cells(line: &str, separator: Separator) -> Vec<String> {
    let spaced;
    let line = match separator {
        Separator::Spaces => {
            spaced = with_tabs(line);
            &spaced
        }
        _ => line,
    };
    let line = line.strip_prefix('\u{feff}').unwrap_or(line);
    if !line.contains('"') {
        return unquoted_cells(line, separator.byte().into());
    }
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

/// The cells of a line without quotes. Most lines have no quotes, and building a CSV reader for each line takes more time than all other work on it.
fn unquoted_cells(line: &str, separator: char) -> Vec<String> {
    if line.is_empty() {
        return vec![];
    }
    let cells = line.split(separator);
    cells.map(|cell| cell.trim().to_owned()).collect()
}

/// Replaces each run of spaces and tabs outside quoted cells by one tab. A quote opens a quoted cell only as its first character.
pub fn with_tabs(line: &str) -> String {
    let mut found = String::with_capacity(line.len());
    let (mut begins_quoted, mut is_quoted) = (false, false);
    for c in line.trim().chars() {
        let begins = !is_quoted && (found.is_empty() || found.ends_with('\t'));
        begins_quoted = c == '"' && begins || begins_quoted && !begins;
        is_quoted ^= c == '"' && begins_quoted;
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

pub fn comment_mark(line: &str) -> Option<&'static str> {
    let line = line.trim_start();
    COMMENT_MARKS
        .into_iter()
        .find(|mark| line.starts_with(mark))
}

/// The separator in a line such as `sep=;`, which spreadsheets write as the first line.
pub fn declared_separator(line: &str) -> Option<Separator> {
    let plain = line.trim_matches(['"', '\u{feff}', ' ']);
    let mark = plain
        .get(..4)
        .filter(|start| start.eq_ignore_ascii_case("sep="))?;
    let rest = &plain[mark.len()..];
    Separator::parse(if rest == "\t" { rest } else { rest.trim() })
}

pub fn is_numeric(cell: &str) -> bool {
    cell.trim().replace(',', ".").parse::<f64>().is_ok()
}
