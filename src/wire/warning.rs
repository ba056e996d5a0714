//! Warnings about a set, a report or an answer.

use crate::calibration::report;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of points that a text names.
const MAX_NAMED: usize = 12;

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
    /// Names of the points in these rows, as the file has them; absent if it names no points.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<String>,
}

impl Warning {
    /// A warning that is not about rows.
    pub fn new(code: &str, detail: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            detail: detail.into(),
            rows: vec![],
            points: vec![],
        }
    }

    /// Adds the names of its points. `name` gives the name of the point in a row.
    pub fn with_point_names<'n>(mut self, name: impl Fn(usize) -> Option<&'n str>) -> Self {
        let names = self.rows.iter().map(|row| name(*row).map(str::to_owned));
        self.points = names.collect::<Option<_>>().unwrap_or_default();
        self
    }

    /// The names of its points for the end of a text: ` (P5, P7)`; empty if there are none.
    pub fn points_in_words(&self) -> String {
        let some: Vec<&str> = self
            .points
            .iter()
            .take(MAX_NAMED)
            .map(String::as_str)
            .collect();
        let more = self.points.len() - some.len();
        match (some.is_empty(), more) {
            (true, _) => String::new(),
            (_, 0) => format!(" ({})", some.join(", ")),
            _ => format!(" ({} and {more} more)", some.join(", ")),
        }
    }
}

impl From<&report::Warning> for Warning {
    fn from(warning: &report::Warning) -> Self {
        Self {
            code: warning.code.into(),
            detail: warning.detail.clone(),
            rows: warning.rows.clone(),
            points: vec![],
        }
    }
}
