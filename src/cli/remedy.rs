//! Remedies as options and commands. A text names its remedy in words; here are the options of a column mapping and the command for a code.

use super::column_options::options;
use crate::wire::suspicion::Insist;
use serde_json::{Deserializer, Value};

/// What precedes a column mapping in a text.
const MAPPING: &str = "in the column mapping: ";

/// The text with options in place of each column mapping: `with --column x_mm="X (mm)"`.
pub fn with_options(text: &str) -> String {
    let (mut found, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once(MAPPING) {
        let mut mapping = Deserializer::from_str(after).into_iter::<Value>();
        let said = match mapping.next() {
            Some(Ok(Value::Object(mapping))) => format!("with {}", options(&mapping)),
            _ => MAPPING.to_owned(),
        };
        found = found + before + &said;
        rest = &after[mapping.byte_offset()..];
    }
    found + rest
}

/// The text with options, and with the command or option that does what this code asks for.
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
                "with --column instrument.name=3 --column robot.name=COLUMN. Say so with --join order",
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
