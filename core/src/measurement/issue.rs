//! Errors in a measurement file, with their positions.

/// Maximum number of errors that are reported at once. A wrong column causes one error per row.
pub const MAX_ISSUES: usize = 20;

/// One error in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issue {
    /// Data row, 0-based (the header is not counted), if the error is about a row.
    pub row: Option<usize>,
    /// The line of that row, counted from 1, if it is known.
    pub line: Option<usize>,
    /// Name of the column, if the error is about a column.
    pub column: Option<String>,
    /// Machine-readable code; it never changes.
    pub code: &'static str,
    /// What is wrong and how to correct it.
    pub detail: String,
}

/// Why a file was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the measurement file cannot be used: {} problem(s), the first: {}", .issues.len(), .issues.first().map_or("", |i| &i.detail))]
pub struct ParseError {
    /// The errors, at most [`MAX_ISSUES`].
    pub issues: Vec<Issue>,
}

impl Issue {
    /// An issue of the whole file.
    pub fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            row: None,
            line: None,
            column: None,
            code,
            detail: detail.into(),
        }
    }

    /// The same issue, with its row.
    pub fn in_row(self, row: impl Into<Option<usize>>) -> Self {
        let row = row.into();
        Self { row, ..self }
    }

    /// The same issue, with its column.
    pub fn in_column(self, column: impl Into<Option<String>>) -> Self {
        let column = column.into();
        Self { column, ..self }
    }
}

impl ParseError {
    pub(super) fn new(mut issues: Vec<Issue>) -> Self {
        issues.truncate(MAX_ISSUES);
        Self { issues }
    }
}

/// A refusal of the whole file.
pub(super) fn whole(code: &'static str, detail: String) -> ParseError {
    ParseError {
        issues: vec![Issue::new(code, detail)],
    }
}
