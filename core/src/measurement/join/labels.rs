//! Normal forms for comparing names and numbers of points.

use std::collections::BTreeMap;

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

/// The numbers in names, for a caller who says that they pair the rows. Names that are called otherwise than most, and names without a number or with several,
/// have none: of `P1`, `P2` and `DRIFT_1` the last.
pub fn numbers_of(labels: &[String]) -> Vec<String> {
    let word = |label: &String| -> String {
        let last = last_part(label);
        last.chars().filter(|c| c.is_alphabetic()).collect()
    };
    let numbers: Vec<Option<String>> = labels.iter().map(|label| only_number(label)).collect();
    let mut n_called: BTreeMap<String, usize> = BTreeMap::new();
    for (label, number) in labels.iter().zip(&numbers) {
        *n_called.entry(word(label)).or_default() += usize::from(number.is_some());
    }
    let usual = n_called.into_iter().max_by_key(|(_, n)| *n);
    let usual = usual.map_or(String::new(), |(word, _)| word);
    let own = |(label, number): (&String, Option<String>)| match word(label) == usual {
        true => number.unwrap_or_default(),
        false => String::new(),
    };
    labels.iter().zip(numbers).map(own).collect()
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
    use super::{are_numbered, numbers_of, only_number, without_punctuation};

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
        assert_eq!(
            numbers_of(&labels(&[
                "Point 01",
                "Point 2",
                "DRIFT_1",
                "HOME",
                "Point 1_2"
            ])),
            ["1", "2", "", "", ""]
        );
    }
}
