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

/// Beginning of a warning about a separate verification set.
const IN_THE_VERIFY_SET: &str = "in the verify set: ";

impl Warning {
    /// The same, marked as a warning about a separate verification set. Its rows are those of that set.
    pub fn of_the_verify_set(self) -> Self {
        Self {
            detail: format!("{IN_THE_VERIFY_SET}{}", self.detail),
            ..self
        }
    }

    /// Whether it is about a separate verification set.
    pub fn is_of_the_verify_set(&self) -> bool {
        self.detail.starts_with(IN_THE_VERIFY_SET)
    }

    /// A warning that is not about rows.
    pub fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            code,
            detail: detail.into(),
            rows: vec![],
        }
    }
}
