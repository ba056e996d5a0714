//! Texts of codes, from `web/words.js`, which the dashboard uses too.

use crate::wire::job_answer::Stage;
use crate::wire::measurement::Warning;
use std::collections::HashMap;
use std::sync::LazyLock;

/// Parsed as lines of `name: "words",` within `export const TABLE = {`.
const TEXT: &str = include_str!("../../web/words.js");

/// Words by table and code.
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

/// A warning's code in words.
pub fn warning(code: &str) -> String {
    of("WARNINGS", code)
}

/// What a wrong file looks like. Of a file that was insisted on, the warning itself repeats what its refusal said.
const LOOKS_OF_A_WRONG_FILE: [&str; 3] = ["session_does_not_fit", "no_fit", "joint_map_suspect"];

/// Why a warning among others matters and what to do about it; empty for a code of another version.
pub fn advice(code: &str, among: &[Warning]) -> Vec<&'static str> {
    let is_insisted = among.iter().any(|other| other.code == "insisted_upload");
    if is_insisted && LOOKS_OF_A_WRONG_FILE.contains(&code) {
        return vec![];
    }
    let texts = ["MATTERS", "REMEDIES"].map(|table| WORDS.get(&(table, code)).copied());
    texts.into_iter().flatten().collect()
}

/// Why a result cannot be used, in words.
pub fn no_use(code: &str) -> String {
    of("NO_USE", code)
}

/// A correction's kind in words.
pub fn correction(kind: &str) -> String {
    of("CORRECTIONS", kind)
}

/// A method in words.
pub fn method(method: &str) -> String {
    WORDS
        .get(&("METHODS", method))
        .map_or_else(|| method.replace('_', " "), |words| (*words).into())
}

/// A job's stage in words.
pub fn stage(stage: Option<Stage>) -> String {
    stage.map_or_else(|| "Computing".into(), |stage| of("STAGES", stage.as_str()))
}

/// A gate of the release in words.
pub fn gate(gate: &str) -> String {
    of("GATES", gate)
}

/// The text of a code. For a code without a text, as in a report of another version, the code itself as the beginning of a sentence.
fn of(table: &str, code: &str) -> String {
    WORDS
        .get(&(table, code))
        .map_or_else(|| capital(&code.replace('_', " ")), |words| (*words).into())
}

/// The text with a capital first letter.
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::{WORDS, correction, gate, method, stage, warning};
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
        assert_eq!(correction("link_masses"), "Masses of the links");
        assert_eq!(gate("identity"), "It is the same robot");
        assert_eq!(
            (method("least_squares"), method("not_thought_of")),
            ("least squares".into(), "not thought of".into())
        );
        assert_eq!(warning("identity"), "Identity");
        assert_eq!(gate("not_thought_of"), "Not thought of");
    }
}
