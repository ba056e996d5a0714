//! Normal forms for comparing names and numbers of points.

use std::collections::{BTreeMap, BTreeSet};

/// A name without punctuation, spaces and leading zeros: `P_01`, `P-1` and `p 1` are the same name.
pub fn without_punctuation(label: &str) -> String {
    let (mut found, mut digits) = (String::new(), String::new());
    for c in last_part(label).chars().chain([' ']) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            // Two adjacent numbers stay separate, so that P1_2 differs from P12.
            if found.ends_with(|c: char| c.is_ascii_digit()) {
                found.push('_');
            }
            let plain = digits.trim_start_matches('0');
            found.push_str(if plain.is_empty() { "0" } else { plain });
            digits.clear();
        }
        if c.is_alphabetic() {
            found.push(c);
        }
    }
    found
}

pub fn exact(label: &str) -> String {
    label.to_owned()
}

pub fn lower(label: &str) -> String {
    label.to_lowercase()
}

/// The last part of a name such as `collection::group::P1`.
pub fn last_part(label: &str) -> String {
    let lower = label.to_lowercase();
    let last = lower.rsplit("::").next().unwrap_or_default();
    last.trim().to_owned()
}

/// A number without leading zeros.
pub fn number(label: &str) -> String {
    label
        .parse::<f64>()
        .map_or_else(|_| label.to_owned(), |number| number.to_string())
}

/// The number in a name, if it has exactly one: 1 for `P1`, `Point 01` and `1`.
pub fn only_number(label: &str) -> Option<String> {
    let plain = number(&last_part(label));
    let mut numbers = plain
        .split(|c: char| !c.is_ascii_digit())
        .filter(|digits| !digits.is_empty());
    let digits = numbers.next().filter(|_| numbers.next().is_none())?;
    let plain = digits.trim_start_matches('0');
    Some(if plain.is_empty() { "0" } else { plain }.to_owned())
}

/// Two kinds of names of one file, of which either may be the points': `Point` and `Nominal` where `Point 1` and `Nominal 1` stand in it.
pub struct TwoWords(pub String, pub String);

/// The numbers in the names of two files, for a caller who says that they pair the rows. A name without a number, with several, or with another word than
/// the points' has none: of `P1`, `P2` and `DRIFT_1` the last. The points' word is the one that both files have, or else the one with the most numbers.
///
/// # Errors
/// [`TwoWords`] if another word has at least half as many numbers.
pub fn numbers_in_names(ours: &[String], theirs: &[String]) -> Result<[Vec<String>; 2], TwoWords> {
    let words = [numbers_by_word(ours), numbers_by_word(theirs)];
    let is_shared = |word: &String| words.iter().all(|of_file| of_file.contains_key(word));
    let has_shared = words[0].keys().any(is_shared);
    let mut found = [vec![], vec![]];
    for ((labels, of_file), found) in [ours, theirs].iter().zip(&words).zip(&mut found) {
        let candidates = of_file
            .iter()
            .filter(|(word, _)| !has_shared || is_shared(word));
        let mut candidates: Vec<(&String, usize)> =
            candidates.map(|(word, n)| (word, n.len())).collect();
        candidates.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        if let [(first, most), (second, n), ..] = candidates[..]
            && 2 * n >= most
        {
            return Err(TwoWords(first.clone(), second.clone()));
        }
        let of_points = candidates.first().map(|(word, _)| *word);
        let own = |label: &String| {
            let is_point = of_points.is_some_and(|of_points| word(label) == *of_points);
            only_number(label).filter(|_| is_point).unwrap_or_default()
        };
        *found = labels.iter().map(own).collect();
    }
    Ok(found)
}

/// The letters of a name's last part.
fn word(label: &str) -> String {
    let last = last_part(label);
    last.chars().filter(|c| c.is_alphabetic()).collect()
}

fn numbers_by_word(labels: &[String]) -> BTreeMap<String, BTreeSet<String>> {
    let mut found: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for label in labels {
        if let Some(number) = only_number(label) {
            found.entry(word(label)).or_default().insert(number);
        }
    }
    found
}

/// Whether each name has one number, and different names have different numbers.
pub fn are_numbered(labels: &[String]) -> bool {
    let mut names: BTreeMap<String, String> = BTreeMap::new();
    labels.iter().all(|label| {
        only_number(label).is_some_and(|number| {
            let name = lower(label.trim());
            *names.entry(number).or_insert_with(|| name.clone()) == name
        })
    })
}

#[cfg(test)]
mod tests {
    use super::{are_numbered, numbers_in_names, only_number, without_punctuation};

    #[test]
    fn names_are_compared_in_several_forms() {
        assert_eq!(without_punctuation("P_01"), without_punctuation("p 1"));
        for (label, number) in [
            ("P1", Some("1")),
            ("Cell::Point 07", Some("7")),
            ("XP10", Some("10")),
            ("3.0", Some("3")),
            ("0", Some("0")),
            ("HOME", None),
            ("P1_2", None),
        ] {
            assert_eq!(only_number(label).as_deref(), number, "{label}");
        }
        let labels = |all: &[&str]| -> Vec<String> { all.iter().map(|l| (*l).into()).collect() };
        assert!(are_numbered(&labels(&["P1", "P2", "P1"])));
        assert!(!are_numbered(&labels(&["P1", "T1"])));
        assert!(!are_numbered(&labels(&["P1", "HOME"])));
        let numbers = |ours: &[&str], theirs: &[&str]| {
            let found = numbers_in_names(&labels(ours), &labels(theirs));
            found.map_err(|words| (words.0, words.1))
        };
        let robot = ["P1", "P2", "P3"];
        let found = numbers(
            &robot,
            &[
                "Point 01",
                "Point 2",
                "Point 3",
                "DRIFT_1",
                "HOME",
                "Point 1_2",
            ],
        );
        assert_eq!(found.unwrap()[1], ["1", "2", "3", "", "", ""]);
        // The word that both files have, however many others there are.
        let found = numbers(&robot, &["Q1", "Q2", "Q3", "Q4", "P1", "P2", "P3"]);
        assert_eq!(found.unwrap()[1], ["", "", "", "", "1", "2", "3"]);
        let found = numbers(&robot, &["Point 1", "Point 2", "Nom 1", "Nom 2", "Nom 3"]);
        assert_eq!(found.unwrap_err(), ("nom".into(), "point".into()));
    }
}
