//! Readable texts for codes. They are in `web/words.js`, which the dashboard uses too.

use crate::wire::job_answer::Stage;
use crate::wire::measurement::Warning;
use std::collections::HashMap;
use std::sync::LazyLock;

/// The file is parsed line by line: lines `name: "words",` inside `export const TABLE = {`.
const TEXT: &str = include_str!("../../web/words.js");

/// Readable texts by table and code.
static WORDS: LazyLock<HashMap<(&'static str, &'static str), &'static str>> = LazyLock::new(|| {
    let mut table = "";
    let mut words = HashMap::new();
    for line in TEXT.lines() {
        if let Some(name) = line.strip_prefix("export const ") {
            table = name.split(' ').next().unwrap_or_default();
        } else if let Some((code, text)) = line.trim().split_once(": \"") {
            words.insert((table, code), text.trim_end_matches("\","));
        }
    }
    words
});

/// Readable text for the code of a warning.
pub fn warning(code: &str) -> String {
    text_of("WARNINGS", code)
}

/// Warnings that are typical of a wrong file. If the uploader overrode a refusal with `insist`, no advice is added to them, because the warning
/// repeats the text of the refusal.
const WRONG_FILE_WARNINGS: [&str; 3] = ["session_does_not_fit", "no_fit", "joint_map_suspect"];

/// Why a warning matters and what to do about it. `among` are all warnings of the report. Empty for an unknown code, as of another version.
pub fn advice(code: &str, among: &[Warning]) -> Vec<&'static str> {
    let is_insisted = among.iter().any(|other| other.code == "insisted_upload");
    if is_insisted && WRONG_FILE_WARNINGS.contains(&code) {
        return vec![];
    }
    let texts = ["MATTERS", "REMEDIES"].map(|table| WORDS.get(&(table, code)).copied());
    texts.into_iter().flatten().collect()
}

/// Readable text for the code of why a result cannot be used.
pub fn no_use(code: &str) -> String {
    text_of("NO_USE", code)
}

/// Readable text for the kind of a correction.
pub fn correction(kind: &str) -> String {
    text_of("CORRECTIONS", kind)
}

/// Readable text for a method.
pub fn method(method: &str) -> String {
    WORDS
        .get(&("METHODS", method))
        .map_or_else(|| method.replace('_', " "), |words| (*words).into())
}

/// Readable text for the stage of a job.
pub fn stage(stage: Option<Stage>) -> String {
    stage.map_or_else(
        || "Computing".into(),
        |stage| text_of("STAGES", stage.as_str()),
    )
}

/// The readable text of a code. For a code without a text, as in a report of another version, this is the code itself with spaces and a capital
/// letter.
fn text_of(table: &str, code: &str) -> String {
    WORDS
        .get(&(table, code))
        .map_or_else(|| capital(&code.replace('_', " ")), |words| (*words).into())
}

/// The text with its first letter in upper case.
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::{WORDS, correction, method, stage, text_of, warning};
    use crate::wire::job_answer::Stage;

    #[test]
    fn every_stage_has_its_words_and_its_name_on_the_wire() {
        for known in Stage::ALL {
            assert!(
                WORDS.contains_key(&("STAGES", known.as_str())),
                "{known:?} has no words"
            );
            assert_eq!(serde_json::json!(known), known.as_str());
            assert_eq!(Stage::parse(known.as_str()), Some(known));
        }
        assert_eq!(stage(None), "Computing");
        assert_eq!(Stage::parse("not_thought_of"), None);
    }

    #[test]
    fn known_codes_have_their_words_and_others_are_spelled_out() {
        assert_eq!(warning("no_verify_points"), "Nothing was kept to verify");
        assert_eq!(
            correction("link_masses"),
            "Masses and centres of gravity of the links"
        );
        assert_eq!(text_of("GATES", "identity"), "It is the same robot");
        assert_eq!(
            (method("least_squares"), method("not_thought_of")),
            ("least squares".into(), "not thought of".into())
        );
        assert_eq!(warning("identity"), "Identity");
        assert_eq!(text_of("GATES", "not_thought_of"), "Not thought of");
    }
}
