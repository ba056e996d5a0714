//! Refuses rows that are too long, before a file is parsed.

use crate::measurement::issue::{Issue, ParseError};

/// Maximum length of a row, bytes: a hundred times the usual length. Without this limit, several copies of an endless row would be held in
/// memory.
const MAX_ROW_BYTES: usize = 64 * 1024;

/// Position of a byte in a cell.
#[derive(Clone, Copy, PartialEq)]
enum At {
    Start,
    Unquoted,
    Quoted,
    /// After a quote in a quoted cell. This quote either ends the cell, or is the first of two quotes that stand for one.
    Closed,
}

/// Refuses rows that are too long. A quote at the beginning of a cell opens a quoted cell; line breaks inside it are text.
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
                // A line break directly after another one, as in \r\n, does not end a row.
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
