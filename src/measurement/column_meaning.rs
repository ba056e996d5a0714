//! Meanings of columns as written in mappings: `q1_deg`, `x_mm`, `station`, `name`.

use crate::measurement::column_names::{Key, LENGTHS, TimeUnit};
use crate::measurement::csv_columns::{Column, column_of};
use crate::measurement::csv_issue::Issue;
use std::collections::BTreeSet;

/// The column type of a meaning, if the column is read as a measurement.
pub(super) fn column(means: &str, n_joints: usize) -> Option<Column> {
    if let Some((axis, unit)) = means.split_once('_') {
        let axis = ["x", "y", "z"].iter().position(|name| *name == axis);
        let factor = LENGTHS.iter().find(|(name, _)| *name == unit);
        if let (Some(axis), Some((_, factor))) = (axis, factor) {
            return Some(Column::Position(axis, *factor));
        }
    }
    column_of(means, n_joints).ok()
}

/// The join key of a meaning, if the meaning is one.
pub fn key(means: &str) -> Option<Key> {
    Some(match means {
        "name" => Key::Name,
        "number" => Key::Number,
        "time" => Key::Time(TimeUnit::Unstated),
        "time_s" => Key::Time(TimeUnit::Seconds),
        "time_ms" => Key::Time(TimeUnit::Milliseconds),
        "time_us" => Key::Time(TimeUnit::Microseconds),
        _ => return None,
    })
}

/// Maximum number of links of a robot.
const MAX_LINKS: usize = 12;

/// Whether a text is the meaning of a column, for any robot.
pub fn is_meaning(means: &str) -> bool {
    column(means, MAX_LINKS).is_some() || key(means).is_some()
}

pub(super) fn key_name(key: Key) -> String {
    match key {
        Key::Name => "name".into(),
        Key::Number => "number".into(),
        Key::Time(unit) => unit
            .as_str()
            .map_or("time".into(), |unit| format!("time_{unit}")),
    }
}

/// The quantity of a meaning, without its unit: `q1`, `x`, `time`, `station`.
pub(super) fn thing(means: &str) -> &str {
    let (base, _) = means.split_once('_').unwrap_or((means, ""));
    let is_axis = matches!(base, "x" | "y" | "z" | "time");
    let is_joint = base
        .strip_prefix('q')
        .is_some_and(|rest| rest.parse::<usize>().is_ok());
    if is_axis || is_joint { base } else { means }
}

/// The unit of a joint value or a coordinate.
pub(super) fn unit(means: &str) -> Option<&'static str> {
    let unit = means.strip_prefix(thing(means))?.strip_prefix('_')?;
    let angles = ["deg", "rad"].into_iter();
    let mut units = angles.chain(LENGTHS.iter().map(|(name, _)| *name));
    units.find(|known| *known == unit && key(means).is_none())
}

/// The issue to report if joints or coordinates are in two units.
pub(super) fn mixed_units<'m>(means: impl Iterator<Item = &'m str>) -> Option<Issue> {
    let (mut lengths, mut angles) = (BTreeSet::new(), BTreeSet::new());
    for (base, unit) in means.filter_map(|means| means.split_once('_')) {
        let is_joint = (base.strip_prefix('q')).is_some_and(|n| n.parse::<usize>().is_ok());
        match base {
            "x" | "y" | "z" => lengths.insert(unit),
            _ if is_joint => angles.insert(unit),
            _ => false,
        };
    }
    let detail = "joints (or coordinates) are in two different units; use one unit for all of them";
    (lengths.len() > 1 || angles.len() > 1).then(|| Issue {
        row: None,
        column: None,
        code: "mixed_units",
        detail: detail.into(),
    })
}
