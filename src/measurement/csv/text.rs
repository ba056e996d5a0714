//! Checks of a measurement file before it is parsed: it must be text, and its rows must not be too long.

use crate::measurement::conventions::Decimal;
use crate::measurement::issue::{Issue, ParseError, whole};

/// Maximum length of a row, bytes: a hundred times the length of a usual row. Without the limit, a row without end would be held in memory several
/// times.
const MAX_ROW_BYTES: usize = 64 * 1024;

/// Decodes UTF-8 text and removes a byte order mark. Files that are not CSV, or that have another separator, are refused.
pub fn decode(bytes: &[u8], decimal: Decimal) -> Result<&str, ParseError> {
    if bytes.starts_with(b"PK\x03\x04") {
        return Err(whole(
            "not_csv",
            "this is a zip or xlsx file; save the sheet as CSV (UTF-8) and upload that".into(),
        ));
    }
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let text = std::str::from_utf8(bytes).map_err(|e| {
        whole(
            "not_utf8",
            format!(
                "byte {} is not UTF-8 text; save the file as CSV (UTF-8)",
                e.valid_up_to()
            ),
        )
    })?;
    let text = text.trim_start_matches('\u{feff}');
    if text.trim().is_empty() {
        return Err(whole("empty", "the file is empty".into()));
    }
    let header = text.lines().next().unwrap_or("");
    let separated_by = |c: char| header.contains(c);
    let detail = match decimal {
        Decimal::Point if !separated_by(',') && (separated_by(';') || separated_by('\t')) => {
            "columns are separated by ';' or tabs; separate them by ',' with '.' as the decimal point, or declare a file with ';' and \
             decimal commas in the column mapping: {\"decimal\": \"comma\"}"
        }
        Decimal::Comma if !separated_by(';') && (separated_by(',') || separated_by('\t')) => {
            "decimal commas were declared, so columns have to be separated by ';', not by ',' or tabs"
        }
        _ => return Ok(text),
    };
    Err(whole("wrong_separator", detail.into()))
}

/// Position of a byte in a cell.
#[derive(Clone, Copy, PartialEq)]
enum At {
    Start,
    Unquoted,
    Quoted,
    /// After a quote in a quoted cell. This quote either ends the cell, or is the first of two quotes that stand for one.
    Closed,
}

/// Refuses rows that are too long, before the text is parsed. A quote at the beginning of a cell opens a quoted cell; line endings inside it are
/// text.
pub fn refuse_endless_rows(text: &[u8], separator: u8) -> Result<(), ParseError> {
    if text.len() <= MAX_ROW_BYTES {
        return Ok(());
    }
    let (mut n_rows, mut length, mut at) = (0_usize, 0_usize, At::Start);
    for &byte in text {
        length += 1;
        at = match (at, byte) {
            (At::Quoted, b'"') => At::Closed,
            (At::Quoted, _) | (At::Start | At::Closed, b'"') => At::Quoted,
            (_, b'\n' | b'\r') => {
                // A line ending directly after another one, as in \r\n, does not end a row.
                n_rows += usize::from(length > 1);
                length = 0;
                At::Start
            }
            (_, byte) if byte == separator => At::Start,
            _ => At::Unquoted,
        };
        if length > MAX_ROW_BYTES {
            // The first row is the header, which is not counted as a data row.
            let row = n_rows.checked_sub(1);
            let detail = format!(
                "a row of more than {} KiB: is an end of line missing, or a quote not closed?",
                MAX_ROW_BYTES / 1024
            );
            return Err(ParseError::new(vec![
                Issue::new("row_too_long", detail).in_row(row),
            ]));
        }
    }
    Ok(())
}
