//! Problem documents (RFC 9457): the format of all error answers.

use crate::wire::Issue;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Media type of a problem.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// Prefix of every `type`. The `code` follows the prefix.
const TYPE_PREFIX: &str = "urn:kincal:problem:";

/// A problem (RFC 9457).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// `urn:kincal:problem:` followed by the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code as readable text.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What happened, where, and how to correct it.
    pub detail: String,
    /// Stable, machine-readable code.
    pub code: String,
    /// For invalid input: all errors in it. For a refused release: all gates that failed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<Issue>,
}

impl Problem {
    /// A problem with this code. The type and the title are derived from the code.
    pub fn new(status: u16, code: &str, detail: impl Into<String>) -> Self {
        let words = code.replace('_', " ");
        let mut letters = words.chars();
        let title = letters
            .next()
            .map(|first| first.to_uppercase().chain(letters).collect())
            .unwrap_or_default();
        Self {
            kind: format!("{TYPE_PREFIX}{code}"),
            title,
            status,
            detail: detail.into(),
            code: code.into(),
            errors: Vec::new(),
        }
    }
}
