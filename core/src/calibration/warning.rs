//! A warning: its stable code, its text, and the rows that it is about.

/// A warning in the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Machine-readable code; it never changes.
    pub code: &'static str,
    /// Text for people.
    pub detail: String,
    /// 0-based data rows concerned, if any.
    pub rows: Vec<usize>,
}

impl Warning {
    /// A warning that is not about rows.
    pub fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            code,
            detail: detail.into(),
            rows: vec![],
        }
    }
}
