//! Remedies as options and commands. The texts of the service describe a remedy in words. This file adds the options of a column mapping,
//! and the command for a code.

use crate::wire::suspicion::Insist;
use serde_json::{Deserializer, Map, Value};

/// Text before a column mapping in a message.
const MAPPING: &str = "in the column mapping: ";

/// Replaces each column mapping in a text with options: `with --column x_mm="X (mm)"`.
pub fn with_options(text: &str) -> String {
    let (mut found, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once(MAPPING) {
        let mut mapping = Deserializer::from_str(after).into_iter::<Value>();
        match mapping.next() {
            Some(Ok(Value::Object(said))) => {
                found = found + before + "with " + &options(&said);
                rest = &after[mapping.byte_offset()..];
            }
            _ => {
                found = found + before + MAPPING;
                rest = after;
            }
        }
    }
    found + rest
}

/// Replaces column mappings in a text with options, and appends the command or option for this code.
pub fn in_commands(code: &str, text: &str) -> String {
    let text = with_options(text);
    match command(code) {
        Some(command) => format!("{text} ({command})"),
        None => text,
    }
}

/// The command or option for the code of a refusal, of a warning or of a failed gate.
fn command(code: &str) -> Option<String> {
    let command = match code {
        "archived" => "kincal restore ID",
        "frame_suspect" => "--frame instrument",
        "joint_map_suspect" => {
            "--joint-map '{…}' with that joint_map, for kincal calibrate and for kincal robots edit ROBOT"
        }
        "rotation_required" => "--rotation CONVENTION",
        "check_robot" | "measured_since_check" | "sessions_fit" | "scored_on_later_sessions" => {
            "kincal submit --verify --robot ROBOT SESSION --parameters ID; kincal checked ROBOT --reason TEXT"
        }
        "evidence" | "verified" | "orientation_known" => {
            "kincal submit --verify --robot ROBOT SESSION --parameters ID"
        }
        "no_active_parameter_set" => "kincal release ID --reason TEXT",
        _ => "",
    };
    let insist = Insist::parse(code).map(|code| format!("--insist {}", code.as_str()));
    match (command, insist) {
        ("", insist) => insist,
        (command, None) => Some(command.to_owned()),
        (command, Some(insist)) => Some(format!("{command}, or {insist}")),
    }
}

/// The options that state a mapping. The inverse of `ColumnOptions::body`.
fn options(mapping: &Map<String, Value>) -> String {
    let mut all = Vec::new();
    for (key, value) in mapping {
        match (key.as_str(), value) {
            ("join", Value::Object(join)) => all.extend(join.iter().map(|(key, value)| {
                let option = match key.as_str() {
                    "by" => "join",
                    "tolerance_s" => "join-tolerance-s",
                    _ => "clock-offset-s",
                };
                format!("--{option} {}", argument(value))
            })),
            (file, Value::Object(columns)) => all.extend(
                columns
                    .iter()
                    .map(|(means, column)| format!("--column {file}.{means}={}", argument(column))),
            ),
            (key, Value::Array(columns)) => {
                let key = if key == "groups" { "group" } else { key };
                all.extend(
                    columns
                        .iter()
                        .map(|column| format!("--{key} {}", argument(column))),
                );
            }
            (
                key @ ("joint_unit" | "position_unit" | "header_row" | "separator" | "decimal"
                | "sheet" | "comments"),
                value,
            ) => all.push(format!("--{} {}", key.replace('_', "-"), argument(value))),
            (means, column) => all.push(format!("--column {means}={}", argument(column))),
        }
    }
    all.join(" ")
}

/// The value of an option, in quotes if a shell would not read it as one word.
fn argument(value: &Value) -> String {
    match value {
        Value::String(text) => {
            let is_word = |c: char| c.is_alphanumeric() || "_.-".contains(c);
            match !text.is_empty() && text.chars().all(is_word) {
                true => text.clone(),
                false if text.contains(['$', '`', '!', '\\', '"']) => {
                    format!("'{}'", text.replace('\'', "'\\''"))
                }
                false => format!("\"{text}\""),
            }
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::{in_commands, with_options};

    #[test]
    fn column_mappings_are_options() {
        for (text, expected) in [
            (
                r#"say so in the column mapping: {"x_mm": "X (mm)"}. The table has "X (mm)""#,
                r#"say so with --column x_mm="X (mm)". The table has "X (mm)""#,
            ),
            (
                r#"state it in the column mapping: {"joint_unit": "deg"} (or "rad")"#,
                r#"state it with --joint-unit deg (or "rad")"#,
            ),
            (
                r#"in the column mapping: {"robot": {"name": "COLUMN"}, "instrument": {"name": 3}}. Say so in the column mapping: {"join": {"by": "order"}}"#,
                "with --column robot.name=COLUMN --column instrument.name=3. Say so with --join order",
            ),
            (
                r#"aside in the column mapping: {"ignore": ["A }", "B"]}"#,
                r#"aside with --ignore "A }" --ignore B"#,
            ),
        ] {
            assert_eq!(with_options(text), expected);
        }
    }

    #[test]
    fn a_code_has_its_command() {
        assert_eq!(
            in_commands("archived", "restore it first"),
            "restore it first (kincal restore ID)"
        );
        assert_eq!(
            in_commands("frame_suspect", "read them in the frame instrument"),
            "read them in the frame instrument (--frame instrument, or --insist frame_suspect)"
        );
        assert_eq!(in_commands("fits", "it fits"), "it fits");
    }
}
