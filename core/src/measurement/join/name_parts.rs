//! Parts of names that do not belong to the name of a point: what all names of a file begin with, and the number of a repetition.

use crate::measurement::join::labels::{last_part, without_punctuation};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// Minimum number of different names for finding what all of them begin with.
const MIN_NAMES: usize = 3;

/// What is no part of the points' names.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = LeftOutOfNames)]
pub struct LeftOut {
    /// What all names of the robot's file begin with; absent if it is part of the names.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub robot: String,
    /// What all names of the instrument's file begin with; absent if it is part of the names.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instrument: String,
    /// True if `P1_1` and `P1_2` of the instrument are repetitions of the robot's `P1`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub repetitions: bool,
}

impl LeftOut {
    /// The names of both files without these parts. A name without them stays as it is.
    pub fn names(&self, ours: &[String], theirs: &[String]) -> [Vec<String>; 2] {
        let without = |name: &String, begin: &str| {
            let name = last_part(name);
            name.strip_prefix(begin).map_or(name.clone(), str::to_owned)
        };
        let ours: Vec<String> = ours.iter().map(|name| without(name, &self.robot)).collect();
        let theirs = theirs.iter().map(|name| without(name, &self.instrument));
        let theirs = theirs.map(
            |name| match repetition(&name).filter(|_| self.repetitions) {
                Some((base, _)) => base.to_owned(),
                None => name,
            },
        );
        let theirs = theirs.collect();
        [ours, theirs]
    }

    /// What is left out, in words.
    pub fn in_words(&self) -> String {
        let files = [("robot", &self.robot), ("instrument", &self.instrument)];
        let begins = files.iter().filter(|(_, begin)| !begin.is_empty());
        let begins = begins.map(|(file, begin)| {
            format!("{begin:?}, with which all names of the {file} file begin, is no part of them")
        });
        let repetitions =
            "the last number of the instrument's names counts the repetitions of a point";
        let repetitions = self.repetitions.then(|| repetitions.to_owned());
        begins.chain(repetitions).collect::<Vec<_>>().join("; ")
    }
}

/// The ways in which parts may be left out, the plainest first.
pub fn ways(ours: &[String], theirs: &[String]) -> Vec<LeftOut> {
    let begins = LeftOut {
        robot: shared_begin(ours),
        instrument: shared_begin(theirs),
        repetitions: false,
    };
    let has_begin = !(begins.robot.is_empty() && begins.instrument.is_empty());
    let plain = LeftOut::default();
    let mut found = vec![];
    found.extend(has_begin.then(|| begins.clone()));
    for begins in std::iter::once(plain).chain(has_begin.then_some(begins)) {
        let [_, names] = begins.names(ours, theirs);
        found.extend(are_repetitions(&names).then_some(LeftOut {
            repetitions: true,
            ..begins
        }));
    }
    found
}

/// What all names begin with, up to a sign or a space: `cell4_` of `Cell4_P1`, `Cell4_P2` and `Cell4_P3`. Empty if there is nothing.
fn shared_begin(names: &[String]) -> String {
    let names: BTreeSet<String> = names.iter().map(|name| last_part(name)).collect();
    let (Some(first), Some(last)) = (names.first(), names.last()) else {
        return String::new();
    };
    // In their order, what the first and the last name share is shared by all.
    let same = first.chars().zip(last.chars()).take_while(|(a, b)| a == b);
    let same: String = same.map(|(c, _)| c).collect();
    let at = same.rfind(|c: char| !c.is_alphanumeric());
    let begin = at.map_or("", |at| {
        let sign = same[at..].chars().next().map_or(0, char::len_utf8);
        &same[..at + sign]
    });
    let has_letter = begin.contains(char::is_alphanumeric);
    match names.len() >= MIN_NAMES && has_letter {
        true => begin.to_owned(),
        false => String::new(),
    }
}

/// The name of a point and the number of its repetition in `P1_2`, `P1.2` and `P1 (2)`.
fn repetition(name: &str) -> Option<(&str, u32)> {
    let (base, number) = match name.strip_suffix(')') {
        Some(inner) => inner.rsplit_once('(')?,
        None => name.rsplit_once(['_', '.'])?,
    };
    let base = base.trim_end();
    let is_number = !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit());
    let has_name = base.contains(char::is_alphanumeric);
    (is_number && has_name).then_some((base, number.parse().ok()?))
}

/// Whether the ends of names are numbers of repetitions: every name has one, or a name has several.
fn are_repetitions(names: &[String]) -> bool {
    let mut numbers: BTreeMap<String, BTreeSet<u32>> = BTreeMap::new();
    for (base, number) in names.iter().filter_map(|name| repetition(name)) {
        let base = without_punctuation(base);
        numbers.entry(base).or_default().insert(number);
    }
    let has_all = !names.is_empty() && names.iter().all(|name| repetition(name).is_some());
    has_all || numbers.values().any(|numbers| numbers.len() > 1)
}

#[cfg(test)]
mod tests {
    use super::{LeftOut, repetition, shared_begin, ways};

    fn names(all: &[&str]) -> Vec<String> {
        all.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn what_all_names_begin_with_ends_at_a_sign() {
        for (all, begin) in [
            (["Cell4_P1", "Cell4_P2", "Cell4_P3"], "cell4_"),
            (["KR16-1", "KR16-2", "KR16-10"], "kr16-"),
            (
                ["2026-03-14 P1", "2026-03-14 P2", "2026-03-14 P3"],
                "2026-03-14 ",
            ),
            (["P10", "P11", "P12"], ""),
            (["P1", "P2", "HOME"], ""),
        ] {
            assert_eq!(shared_begin(&names(&all)), begin, "{all:?}");
        }
    }

    #[test]
    fn repetitions_have_a_number_of_their_own() {
        assert_eq!(repetition("p1_2"), Some(("p1", 2)));
        assert_eq!(repetition("p1 (3)"), Some(("p1", 3)));
        assert_eq!(repetition("p1.1"), Some(("p1", 1)));
        assert_eq!(repetition("p11"), None);
        assert_eq!(repetition("_1"), None);
        let robot = names(&["P1", "P2", "P3"]);
        let found = ways(
            &robot,
            &names(&["A::P1_1", "A::P1_2", "A::P2_1", "A::P3_1"]),
        );
        assert_eq!(found.len(), 1);
        let [_, theirs] = found[0].names(&robot, &names(&["A::P1_1", "A::P1_2"]));
        assert_eq!(theirs, ["p1", "p1"]);
        // One name of many may end so for another reason.
        assert_eq!(
            ways(&robot, &names(&["P1_1", "P2", "P3"])),
            Vec::<LeftOut>::new()
        );
    }
}
