//! Groups of points in an instrument's file: `Nominals` and `Measured`, `Raw` and `TempComp`. One point name under two groups is two different
//! things, and not one point that was measured twice.

use crate::measurement::set::Point;
use crate::measurement::table::TableRow;
use std::collections::{BTreeMap, BTreeSet};

/// Between the parts of a name such as `Collection::Group::P1`.
const PART: &str = "::";
/// Maximum number of groups that a message lists.
const MAX_LISTED: usize = 8;

/// The columns of groups and names, and the groups that are read.
#[derive(Default)]
pub struct PointGroups {
    /// The column with the names of the points.
    name: Option<usize>,
    /// The columns of collections and groups.
    columns: Vec<usize>,
    /// The groups to read; empty for all.
    wanted: Vec<String>,
    /// The groups of the file.
    seen: BTreeSet<String>,
    /// The group of each row that is read; empty if it has none.
    pub of_rows: Vec<String>,
    /// Number of rows of groups that are not read.
    pub n_other: usize,
}

impl PointGroups {
    pub fn new(name: Option<usize>, columns: Vec<usize>, wanted: Vec<String>) -> Self {
        Self {
            name,
            columns,
            wanted,
            ..Self::default()
        }
    }

    /// Takes the next row. Returns whether the row is read.
    pub fn take(&mut self, row: &TableRow) -> bool {
        let group = self.group(row);
        let is_read = self.wanted.is_empty() || self.wanted.iter().any(|one| is_of(&group, one));
        self.n_other += usize::from(!is_read);
        if !self.wanted.is_empty() && self.seen.len() <= MAX_LISTED {
            self.seen.insert(group.clone());
        }
        if is_read {
            self.of_rows.push(group);
        }
        is_read
    }

    fn group(&self, row: &TableRow) -> String {
        let cell = |place: &usize| row.cells.get(*place).unwrap_or("").trim();
        let mut parts: Vec<&str> = self.columns.iter().map(cell).collect();
        let name = self.name.as_ref().map_or("", cell);
        parts.extend(name.rsplit_once(PART).map(|(group, _)| group.trim()));
        parts.retain(|part| !part.is_empty());
        parts.join(PART)
    }

    /// The message for stated groups of which the file has no row.
    pub fn unknown(&self) -> Option<String> {
        let is_missing = |one: &&String| !self.seen.iter().any(|group| is_of(group, one));
        let missing = self.wanted.iter().find(is_missing)?;
        let groups = self.seen.iter().filter(|group| !group.is_empty());
        let groups: Vec<String> = groups.map(|group| format!("{group:?}")).collect();
        let has = match groups.is_empty() {
            true => "no groups of points".to_owned(),
            false => format!("the groups {}", groups.join(", ")),
        };
        Some(format!(
            "there is no group of points {missing:?}: the file has {has}"
        ))
    }
}

/// Whether a group is the one that is meant, by its whole name or by one of its parts: `Cell::Measured` is `Measured`.
fn is_of(group: &str, meant: &str) -> bool {
    let (group, meant) = (group.to_lowercase(), meant.trim().to_lowercase());
    group == meant || group.split(PART).any(|part| part.trim() == meant)
}

/// What a row is called without its group. Rows of several reflectors or set-ups are different points.
pub fn point_in_group(name: &str, reflector: &str, point: &Point) -> String {
    let name = name.rsplit(PART).next().unwrap_or_default().trim();
    let others = [
        Some(reflector),
        point.station.as_deref(),
        point.session.as_deref(),
    ];
    let others = others.into_iter().flatten().filter(|text| !text.is_empty());
    let all: Vec<&str> = std::iter::once(name).chain(others).collect();
    all.join(", ")
}

/// The message for points that stand under several groups. Each row has what it is called, and its group.
pub fn several_groups<'r>(rows: impl Iterator<Item = (String, &'r str)>) -> Option<String> {
    let mut by_name: BTreeMap<String, BTreeSet<&str>> = BTreeMap::new();
    for (name, group) in rows {
        by_name.entry(name).or_default().insert(group);
    }
    let shared: Vec<&String> = (by_name.iter())
        .filter(|(_, groups)| groups.len() > 1)
        .map(|(name, _)| name)
        .collect();
    let first = *shared.first()?;
    let mut groups: BTreeMap<&str, usize> = BTreeMap::new();
    for group in by_name.values().flatten() {
        *groups.entry(group).or_default() += 1;
    }
    let listed = groups.iter().take(MAX_LISTED);
    let counts: Vec<String> = listed
        .clone()
        .map(|(group, n)| format!("{group:?} ({n} point{})", if *n == 1 { "" } else { "s" }))
        .collect();
    let remedies: Vec<String> = listed
        .clone()
        .filter(|(group, _)| !group.is_empty())
        .map(|(group, _)| format!("in the column mapping: {{\"groups\": [{group:?}]}}"))
        .collect();
    let all: Vec<String> = listed.map(|(group, _)| format!("{group:?}")).collect();
    let more = match groups.len().saturating_sub(MAX_LISTED) {
        0 => String::new(),
        n => format!(" and {n} more groups"),
    };
    let others = match shared.len() - 1 {
        0 => String::new(),
        1 => ", and one other name too".to_owned(),
        n => format!(", and {n} other names too"),
    };
    Some(format!(
        "the point {first:?} stands under several groups{others}: {}{more}. Nominal and measured, or raw and compensated positions are no repetitions of each other: \
         say which group is to be read, {}. If the groups are reflectors or set-ups of the instrument, add a column target or station. If they are repeated measurements of the same points, name them all, in the column mapping: {{\"groups\": [{}]}}",
        counts.join(", "),
        remedies.join(" or "),
        all.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::{is_of, several_groups};

    #[test]
    fn a_group_is_meant_by_its_name_or_a_part_of_it() {
        assert!(is_of("Cell::Measured", "measured") && is_of("Cell::Measured", "cell::measured"));
        assert!(!is_of("Cell::Measured", "Meas") && !is_of("", "Measured"));
    }

    #[test]
    fn names_of_one_group_or_of_one_alone_are_fine() {
        let found = |rows: &[(&str, &'static str)]| {
            several_groups(
                rows.iter()
                    .map(|(name, group)| ((*name).to_owned(), *group)),
            )
        };
        assert_eq!(found(&[("p1", "A"), ("p1", "A"), ("p2", "B")]), None);
        let told = found(&[("p1", "A"), ("p1", "B"), ("p2", "B")]).unwrap();
        assert!(told.contains("\"A\" (1 point), \"B\" (2 points)"), "{told}");
    }
}
