//! Why points may not fit: columns of the upload that were not read.

use crate::wire::understood::Reading;

/// Words in the names of columns that identify the reflector or the instrument's set-up of a row.
const LABELS: [&str; 14] = [
    "target",
    "targets",
    "reflector",
    "reflektor",
    "smr",
    "prism",
    "marker",
    "ball",
    "station",
    "setup",
    "standpunkt",
    "stationierung",
    "placement",
    "location",
];
/// Maximum number of such columns that a message names.
const MAX_LABELS: usize = 4;

/// What may be the cause if the points do not fit: columns that are not read although they may identify the reflector or the instrument's set-up of a
/// row, and the clocks of two files that were paired by time. `None` if there is nothing of this kind.
pub fn unread_labels(reading: &Reading) -> Option<String> {
    let tables = reading.understood.iter().chain(
        reading
            .joined
            .iter()
            .flat_map(|joined| [&joined.robot, &joined.instrument]),
    );
    let is_label = |name: &&String| {
        let lower = name.to_lowercase();
        let mut words = lower.split(|c: char| !c.is_alphabetic());
        words.any(|word| LABELS.contains(&word))
    };
    let names: Vec<String> = tables
        .flat_map(|table| table.ignored.iter().filter(is_label))
        .take(MAX_LABELS)
        .map(|name| format!("{name:?}"))
        .collect();
    let labels = names.first().map(|first| {
        format!(
            "Not read: {}. If such a column says which reflector (target) or which set-up of the instrument (station) a row is of, say so \
             in the column mapping: {{\"target\": {first}}}",
            names.join(", ")
        )
    });
    let offset_s = reading
        .joined
        .as_ref()
        .and_then(|joined| joined.join.clock_offset_s);
    let clocks = offset_s.map(|offset_s| {
        format!(
            "The rows were paired by time, with the robot's clock {offset_s:.3} s ahead of the instrument's: if that is not so, say it \
             in the column mapping: {{\"join\": {{\"clock_offset_s\": \"SECONDS\"}}}}"
        )
    });
    let all: Vec<String> = labels.into_iter().chain(clocks).collect();
    (!all.is_empty()).then(|| all.join(". "))
}
