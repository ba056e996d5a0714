//! Meanings of columns as mappings say them: `q1_deg`, `x_mm`, `station`, `name`.

use crate::measurement::column_names::{Key, LENGTHS, TimeUnit};
use crate::measurement::csv_columns::{Column, column_of};

/// A column that is read as a measurement.
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

/// The key that a meaning is, if it is one.
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

/// Most links of a robot.
const MAX_LINKS: usize = 12;

/// Whether a text is the meaning of a column of some robot.
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

/// The thing that a meaning is about: `q1`, `x`, `time`, `station`.
pub(super) fn thing(means: &str) -> &str {
    let (base, _) = means.split_once('_').unwrap_or((means, ""));
    let is_axis = matches!(base, "x" | "y" | "z" | "time");
    let is_joint = base
        .strip_prefix('q')
        .is_some_and(|rest| rest.parse::<usize>().is_ok());
    if is_axis || is_joint { base } else { means }
}
