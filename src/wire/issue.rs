//! Issues in an upload or a request body, each with its position.

use crate::wire::joint_map::JointMapBody;
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use std::ops::RangeInclusive;
use utoipa::ToSchema;

const OUT_OF_RANGE: &str = "out_of_range";
const WRONG_LENGTH: &str = "wrong_length";
/// Maximum number of issues in one answer. This is enough to correct a file in one go, and few enough to read.
pub const MAX_ISSUES: usize = 100;

/// One error in the input: where it is, what it is, and how to correct it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Issue {
    /// 0-based data row of a CSV file (the header is not counted).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row: Option<usize>,
    /// Line of the file, or row of the sheet, on which the data row begins, counted from 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// Column of a CSV file, or name of a query parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// JSON pointer (RFC 6901) into the request body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointer: Option<String>,
    /// Stable, machine-readable code.
    pub code: String,
    /// Description, with the value found and a hint.
    pub detail: String,
    /// With `joint_map_suspect`: the joint map that the robot should have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<JointMapBody>)]
    pub joint_map: Option<serde_json::Value>,
}

impl Issue {
    /// An issue at a JSON pointer.
    pub fn at(pointer: impl Into<String>, code: &str, detail: impl Into<String>) -> Self {
        Self {
            pointer: Some(pointer.into()),
            code: code.into(),
            detail: detail.into(),
            ..Self::default()
        }
    }

    /// Position and detail as text.
    pub fn in_words(&self) -> String {
        let place = match (&self.pointer, self.row, &self.column) {
            (Some(pointer), _, _) if !pointer.is_empty() => format!("{pointer}: "),
            (_, Some(row), Some(column)) => format!("row {row}, column {column}: "),
            (_, Some(row), None) => format!("row {row}: "),
            (_, None, Some(column)) => format!("{column}: "),
            _ => String::new(),
        };
        // Many details begin with the position.
        if self.detail.starts_with(&place) {
            self.detail.clone()
        } else {
            format!("{place}{}", self.detail)
        }
    }
}

/// Input that was parsed but cannot be used (HTTP status 422), with all issues and where each is: a JSON pointer, or row and column of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.summary())]
pub struct Invalid {
    /// Code of the problem as a whole.
    pub code: &'static str,
    /// The issues, at most [`MAX_ISSUES`].
    pub issues: Vec<Issue>,
}

impl Invalid {
    /// One issue at a JSON pointer. Its code is also the code of the problem.
    pub fn at(pointer: &str, code: &'static str, detail: impl Into<String>) -> Self {
        Self {
            code,
            issues: vec![Issue::at(pointer, code, detail)],
        }
    }

    /// Text of the first issue, and the number of further issues.
    pub fn summary(&self) -> String {
        let Some(first) = self.issues.first() else {
            return "the input cannot be used".into();
        };
        match self.issues.len() - 1 {
            0 => first.in_words(),
            more => format!("{} (and {more} more, see errors)", first.in_words()),
        }
    }
}

/// Collects issues while a document is checked, so that one answer contains all of them.
#[derive(Debug, Default)]
pub struct Checker {
    issues: Vec<Issue>,
}

impl Checker {
    /// Adds an issue. Issues beyond [`MAX_ISSUES`] are dropped.
    pub fn add(&mut self, pointer: impl Into<String>, code: &str, detail: impl Into<String>) {
        if self.issues.len() < MAX_ISSUES {
            self.issues.push(Issue::at(pointer, code, detail));
        }
    }

    /// Adds an issue unless `value` is finite and within `[-limit, limit]`.
    pub fn magnitude(&mut self, pointer: impl Into<String>, value: f64, limit: f64, hint: &str) {
        if value.is_nan() || value.abs() > limit {
            self.add(
                pointer,
                OUT_OF_RANGE,
                format!("{value} is outside ±{limit}: {hint}"),
            );
        }
    }

    /// [`Self::magnitude`] of each value of a list.
    pub fn magnitudes(&mut self, at: &str, values: &[f64], limit: f64, hint: &str) {
        for (i, value) in values.iter().enumerate() {
            self.magnitude(format!("{at}/{i}"), *value, limit, hint);
        }
    }

    /// Adds an issue unless a value is absent or within `range`; `what` says what it is.
    pub fn within<T: PartialOrd + Display>(
        &mut self,
        pointer: impl Into<String>,
        value: impl Into<Option<T>>,
        range: RangeInclusive<T>,
        what: &str,
    ) {
        if let Some(value) = value.into().filter(|value| !range.contains(value)) {
            let (low, high) = range.into_inner();
            let detail = format!("{value} is outside {low} to {high}: {what}");
            self.add(pointer, OUT_OF_RANGE, detail);
        }
    }

    /// Adds an issue unless a value is absent, or above zero and at most `max`; `what` says what it is.
    pub fn above_zero(
        &mut self,
        pointer: impl Into<String>,
        value: impl Into<Option<f64>>,
        max: f64,
        what: &str,
    ) {
        let is_wrong = |value: &f64| value.is_nan() || *value <= 0.0 || *value > max;
        if let Some(value) = value.into().filter(is_wrong) {
            let detail = format!("{value} is not above 0 and at most {max}: {what}");
            self.add(pointer, OUT_OF_RANGE, detail);
        }
    }

    /// Adds an issue unless the number of items of a list is within `range`.
    pub fn count(
        &mut self,
        pointer: impl Into<String>,
        n: usize,
        range: RangeInclusive<usize>,
        items: &str,
    ) {
        if !range.contains(&n) {
            let (low, high) = range.into_inner();
            let detail = format!("{n} {items}; {low} to {high} are allowed");
            self.add(pointer, WRONG_LENGTH, detail);
        }
    }

    /// Adds an issue unless `found` equals `expected`. Returns true if they are equal.
    pub fn length(
        &mut self,
        pointer: impl Into<String>,
        found: usize,
        expected: usize,
        what: &str,
    ) -> bool {
        if found != expected {
            self.add(
                pointer,
                WRONG_LENGTH,
                format!("{found} values where {expected} belong: {what}"),
            );
        }
        found == expected
    }

    /// Adds an issue unless the text has 1 to `max` characters, none of them NUL.
    pub fn text(&mut self, pointer: &str, text: &str, max: usize) {
        let n = text.chars().count();
        if n == 0 || n > max {
            self.add(
                pointer,
                WRONG_LENGTH,
                format!("{n} characters; 1 to {max} are allowed"),
            );
        }
        if text.contains('\0') {
            self.add(
                pointer,
                "nul_character",
                "it contains U+0000, which the database cannot store: remove it",
            );
        }
    }

    /// As [`Self::text`], and the text must contain a letter or a digit, because people read it.
    pub fn words(&mut self, pointer: &str, text: &str, max: usize) {
        self.text(pointer, text, max);
        if !text.is_empty() && !text.chars().any(is_readable) {
            self.add(
                pointer,
                "blank",
                "there is nothing to read in it: write at least one letter or digit",
            );
        }
    }

    /// `Ok` if there are no issues.
    pub fn finish(self, code: &'static str) -> Result<(), Invalid> {
        if self.issues.is_empty() {
            Ok(())
        } else {
            Err(Invalid {
                code,
                issues: self.issues,
            })
        }
    }
}

/// Whether a character is visible and readable. Hangul fillers are excluded: they are letters in Unicode, but are displayed as blanks.
fn is_readable(c: char) -> bool {
    c.is_alphanumeric() && !matches!(c, '\u{115f}' | '\u{1160}' | '\u{3164}' | '\u{ffa0}')
}
