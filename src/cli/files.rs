//! Input files: reading them, and the messages about files that cannot be used.

use super::remedy::in_commands;
use super::usage::Usage;
use crate::measurement::RotationConvention;
use crate::measurement::rotation_convention::CONVENTIONS;
use crate::wire::content_type::{DECIMAL_COMMA, with_rotation};
use crate::wire::issue::Issue;
use crate::wire::json;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Byte order mark (UTF-8) that editors on Windows write.
pub const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// Number format of a measurement set.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct NumberFormat {
    /// The CSV has decimal commas, and semicolons between its columns.
    #[arg(long, env = "KINCAL_DECIMAL_COMMA", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    pub decimal_comma: bool,
    /// What rx_deg, ry_deg and rz_deg of a CSV with poses mean: intrinsic_xyz, extrinsic_xyz, intrinsic_zyx, …, or rotation_vector. Never guessed.
    #[arg(long, env = "KINCAL_ROTATION", value_name = "CONVENTION", value_parser = convention)]
    pub rotation: Option<RotationConvention>,
}

/// Parses a rotation convention.
pub fn convention(name: &str) -> Result<RotationConvention, String> {
    name.parse().map_err(|_| format!("it is {CONVENTIONS}"))
}

impl NumberFormat {
    /// The content type of a measurement set.
    pub fn content_type(self, set: &Path) -> String {
        let plain = match (is_json(set), self.decimal_comma) {
            (true, _) => return "application/json".into(),
            (false, true) => format!("text/csv; {DECIMAL_COMMA}"),
            (false, false) => "text/csv".into(),
        };
        match self.rotation {
            Some(convention) => with_rotation(&plain, convention),
            None => plain,
        }
    }
}

/// True if the file's extension is `json`.
pub fn is_json(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "json")
}

/// A file's bytes.
pub fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).map_err(|e| Usage(format!("cannot read {}: {e}", path.display())).into())
}

/// Reads a JSON file; `what` names its content in messages.
pub fn read_json<T: DeserializeOwned>(path: &Path, what: &str) -> anyhow::Result<T> {
    parse_json(path, &read(path)?, what)
}

/// As [`read_json`], from the file's bytes.
pub fn parse_json<T: DeserializeOwned>(path: &Path, bytes: &[u8], what: &str) -> anyhow::Result<T> {
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    if text.trim_ascii_start().first() != Some(&b'{') {
        return Err(Usage(format!(
            "{}: it is not JSON of {what} (an object is expected, {{…}})",
            path.display()
        ))
        .into());
    }
    Ok(json::parse(text).map_err(|error| match error {
        json::Error::Syntax(detail) => Usage(format!(
            "{}: it is not JSON of {what}: {detail}",
            path.display()
        )),
        json::Error::Shape(invalid) => {
            let issues_in_words = cannot_be_used(path, &invalid.issues);
            Usage(format!("{issues_in_words}\nit has to be {what}"))
        }
    })?)
}

/// The message about a file that cannot be used: one line per issue.
pub fn cannot_be_used(path: &Path, issues: &[Issue]) -> String {
    format!(
        "{} cannot be used:{}",
        path.display(),
        issues_in_words(issues)
    )
}

/// Maximum number of issues in a message; the first ones show what is wrong.
const MAX_SHOWN: usize = 8;

/// One line per issue. An issue that several columns share is stated once, with the names of the other columns.
pub fn issues_in_words(issues: &[Issue]) -> String {
    let mut text = String::new();
    let alike = |a: &Issue, b: &Issue| {
        a.row.is_none()
            && b.row.is_none()
            && a.column.is_some()
            && b.column.is_some()
            && a.code == b.code
            && a.pointer == b.pointer
    };
    for group in issues.chunk_by(alike).take(MAX_SHOWN) {
        text += &format!("\n  {}", issue_in_words(&group[0]));
        let others: Vec<&str> = group[1..]
            .iter()
            .filter_map(|issue| issue.column.as_deref())
            .collect();
        if !others.is_empty() {
            text += &format!("\n  the same for {}", others.join(", "));
        }
    }
    match issues.chunk_by(alike).count().saturating_sub(MAX_SHOWN) {
        0 => text,
        n => text + &format!("\n  and {n} more"),
    }
}

/// Place and detail of an issue. The place is stated once, with the line of the file if it is known.
pub fn issue_in_words(issue: &Issue) -> String {
    let detail = in_commands(&issue.code, &issue.detail);
    let Some(row) = issue.row else {
        let says_it = issue
            .column
            .as_ref()
            .is_some_and(|column| detail.contains(column.as_str()));
        return if says_it || issue.pointer.is_some() {
            detail
        } else {
            Issue {
                detail,
                ..issue.clone()
            }
            .in_words()
        };
    };
    let place = match issue.line {
        Some(line) => format!("row {row} (line {line})"),
        None => format!("row {row}"),
    };
    // With two files, the detail names the file.
    if let Some((file, rest)) = detail.split_once(&format!(" file: row {row}")) {
        return format!("{file} file: {place}{rest}");
    }
    if let Some(rest) = detail.strip_prefix(&format!("row {row}")) {
        return format!("{place}{rest}");
    }
    let column = issue
        .column
        .as_ref()
        .map_or(String::new(), |column| format!(", column {column}"));
    format!("{place}{column}: {detail}")
}

#[cfg(test)]
mod tests {
    use super::{issue_in_words, issues_in_words};
    use crate::wire::issue::Issue;

    #[test]
    fn a_place_is_said_once() {
        let issue = |row: Option<usize>, column: Option<&str>, detail: &str| Issue {
            row,
            line: row.map(|row| row + 2),
            column: column.map(Into::into),
            detail: detail.into(),
            ..Issue::default()
        };
        assert_eq!(
            issue_in_words(&issue(Some(0), None, "row 0 has 20 cells")),
            "row 0 (line 2) has 20 cells"
        );
        assert_eq!(
            issue_in_words(&issue(
                Some(1),
                Some("x_mm"),
                "row 1, column x_mm: \"a\" is not a number"
            ),),
            "row 1 (line 3), column x_mm: \"a\" is not a number"
        );
        assert_eq!(
            issue_in_words(&Issue {
                line: None,
                ..issue(Some(1), Some("x_mm"), "\"a\" is not a number")
            }),
            "row 1, column x_mm: \"a\" is not a number"
        );
        assert_eq!(
            issue_in_words(&issue(None, Some("x"), "column x has no unit")),
            "column x has no unit"
        );
    }

    #[test]
    fn what_is_wrong_with_several_columns_is_said_once() {
        let issue = |column: &str| Issue {
            column: Some(column.into()),
            code: "missing_unit".into(),
            detail: format!("column {column} has no unit"),
            ..Issue::default()
        };
        let text = issues_in_words(&["J1", "J2", "J3"].map(issue));
        assert_eq!(text, "\n  column J1 has no unit\n  the same for J2, J3");
        let of_rows: Vec<Issue> = (0..20)
            .map(|row| Issue {
                row: Some(row),
                ..issue("J1")
            })
            .collect();
        assert!(issues_in_words(&of_rows).ends_with("\n  and 12 more"));
    }
}
