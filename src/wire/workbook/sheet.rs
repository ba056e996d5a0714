//! Converts the cells of a sheet to lines of text with tabs between the cells.

use super::refusal::{refused, too_large, unreadable};
use crate::measurement::table::MAX_COLUMNS;
use crate::wire::Invalid;

/// Maximum size of one sheet as text, bytes. The limit for a CSV file is the same.
const MAX_TEXT_BYTES: usize = 32 * 1024 * 1024;

/// The sheets of a workbook.
pub(super) struct Sheets {
    /// The names of all sheets.
    pub names: Vec<String>,
    /// The sheets with cells, at most two.
    pub found: Vec<Sheet>,
}

/// A sheet with cells.
pub(super) struct Sheet {
    pub name: String,
    pub text: String,
    /// The hidden rows that have cells, counted from 0.
    pub hidden_rows: Vec<usize>,
    /// The rows with a cell that is struck through, counted from 0.
    pub struck_rows: Vec<usize>,
}

/// Writes the cells of a sheet in their order.
#[derive(Default)]
pub(super) struct SheetText {
    text: String,
    row: usize,
    column: usize,
    /// End of the last line that has a cell.
    end: usize,
    hidden_rows: Vec<usize>,
}

impl SheetText {
    /// Adds a cell. Row and column are counted from 0. Empty cells need not be added.
    pub fn cell(
        &mut self,
        row: usize,
        column: usize,
        cell: &str,
        is_hidden: bool,
    ) -> Result<(), Invalid> {
        if cell.is_empty() {
            return Ok(());
        }
        if is_hidden && self.hidden_rows.last() != Some(&row) {
            self.hidden_rows.push(row);
        }
        if row < self.row || row == self.row && column < self.column {
            return Err(unreadable("its cells are not in order"));
        }
        if column >= MAX_COLUMNS || row > 2 * 1024 * 1024 {
            return Err(refused(
                "too_many_columns",
                format!(
                    "cell in row {}, column {}: at most {MAX_COLUMNS} columns are read",
                    row + 1,
                    column + 1
                ),
            ));
        }
        while self.row < row {
            self.text.push('\n');
            (self.row, self.column) = (self.row + 1, 0);
        }
        while self.column < column {
            self.text.push('\t');
            self.column += 1;
        }
        if self.text.len() + cell.len() > MAX_TEXT_BYTES {
            return Err(too_large());
        }
        let plain = cell.replace(['\t', '\n', '\r'], " ");
        if plain.starts_with('"') {
            self.text
                .push_str(&format!("\"{}\"", plain.replace('"', "\"\"")));
        } else {
            self.text.push_str(&plain);
        }
        self.end = self.text.len();
        if self.text.len() > MAX_TEXT_BYTES {
            return Err(too_large());
        }
        Ok(())
    }

    /// The sheet; none if the sheet has no cells.
    pub fn finish(mut self, name: String) -> Option<Sheet> {
        self.text.truncate(self.end);
        self.text.push('\n');
        (self.end > 0).then_some(Sheet {
            name,
            text: self.text,
            hidden_rows: self.hidden_rows,
            struck_rows: vec![],
        })
    }
}
