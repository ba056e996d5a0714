//! Meanings of columns as written in mappings: `q1_deg`, `x_mm`, `station`, `name`.

use crate::measurement::columns::column::{Column, column_of};
use crate::measurement::columns::names::{ANGLES, Key, LENGTHS, TimeUnit};

/// The column type of a meaning, if the column is read as a measurement.
pub fn column(means: &str, n_joints: usize) -> Option<Column> {
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
        "group" => Key::Group,
        "collection" => Key::Collection,
        "time" => Key::Time(TimeUnit::Unstated),
        "time_s" => Key::Time(TimeUnit::Seconds),
        "time_ms" => Key::Time(TimeUnit::Milliseconds),
        "time_us" => Key::Time(TimeUnit::Microseconds),
        _ => {
            let rate = means.strip_prefix("time_")?.strip_suffix("hz")?;
            Key::Time(TimeUnit::of_rate(rate)?)
        }
    })
}

/// Maximum number of links of a robot.
const MAX_LINKS: usize = 12;

/// Whether a text is the meaning of a column, for any robot.
pub fn is_meaning(means: &str) -> bool {
    column(means, MAX_LINKS).is_some() || key(means).is_some()
}

/// The meaning of a join key.
pub fn key_name(key: Key) -> String {
    match key {
        Key::Name => "name".into(),
        Key::Number => "number".into(),
        Key::Group => "group".into(),
        Key::Collection => "collection".into(),
        Key::Time(unit) => unit
            .name()
            .map_or("time".into(), |unit| format!("time_{unit}")),
    }
}

/// The quantity of a meaning, without its unit: `q1`, `x`, `time`, `station`.
pub fn thing(means: &str) -> &str {
    let (base, _) = means.split_once('_').unwrap_or((means, ""));
    let is_axis = matches!(base, "x" | "y" | "z" | "time");
    let is_joint = base
        .strip_prefix('q')
        .is_some_and(|rest| rest.parse::<usize>().is_ok());
    if is_axis || is_joint { base } else { means }
}

/// The unit of a joint value or a coordinate.
pub fn unit(means: &str) -> Option<&'static str> {
    let unit = means.strip_prefix(thing(means))?.strip_prefix('_')?;
    let mut units = ANGLES.iter().chain(&LENGTHS).map(|(name, _)| *name);
    units.find(|known| *known == unit && key(means).is_none())
}
