//! What is wrong with a file of measurements, and where.

/// Most errors reported at once; a wrong column makes one per row.
pub const MAX_ISSUES: usize = 20;

/// One thing that is wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issue {
    /// 0-based data row (the header is not counted), where it is about a row.
    pub row: Option<usize>,
    /// Column name, where it is about a column.
    pub column: Option<String>,
    /// Stable code.
    pub code: &'static str,
    /// What is wrong and how to mend it.
    pub detail: String,
}

/// Why a file was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the measurement file cannot be used: {} problem(s), the first: {}", .issues.len(), .issues.first().map_or("", |i| &i.detail))]
pub struct ParseError {
    /// What is wrong, at most [`MAX_ISSUES`].
    pub issues: Vec<Issue>,
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
        issues: vec![Issue {
            row: None,
            column: None,
            code,
            detail,
        }],
    }
}
