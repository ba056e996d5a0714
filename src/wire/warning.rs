//! Warnings about a set, a report or an answer.

use crate::calibration::report;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A warning.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Warning {
    /// Stable code.
    pub code: String,
    /// Description.
    pub detail: String,
    /// Data rows that the warning is about, 0-based.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<usize>,
}

impl Warning {
    /// A warning that is not about rows.
    pub fn new(code: &str, detail: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            detail: detail.into(),
            rows: vec![],
        }
    }
}

impl From<&report::Warning> for Warning {
    fn from(warning: &report::Warning) -> Self {
        Self {
            code: warning.code.into(),
            detail: warning.detail.clone(),
            rows: warning.rows.clone(),
        }
    }
}
