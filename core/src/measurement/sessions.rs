//! Joins several sessions of one robot to one set of points. Each session keeps its own base, and its own targets unless they have the same
//! names. A posture that was measured in several sessions is one configuration.

use crate::measurement::conventions::Frame;
use crate::measurement::set::MeasurementSet;
use std::collections::BTreeMap;

/// Maximum number of sessions of one job. The number is small because every pair of sessions is compared.
pub const MAX_SESSIONS: usize = 8;

/// The points of all sessions, one session after the other. All sets must be in the same kind of frame. Stations, sessions, targets without names and
/// positions in the measuring order are made unique, so that no two sessions share them.
pub fn joined(sessions: &[MeasurementSet]) -> MeasurementSet {
    let mut points = Vec::new();
    let mut n_targets = 0;
    let mut named: BTreeMap<String, usize> = BTreeMap::new();
    for (session, set) in sessions.iter().enumerate() {
        let order = set.measuring_order();
        let n_before = points.len();
        points.extend(set.points.iter().cloned());
        for (place, row) in order.into_iter().enumerate() {
            points[n_before + row].sequence = (n_before + place) as i64;
        }
        let numbers: Vec<usize> = (0..set.n_targets())
            .map(|target| {
                let next = n_targets;
                let number = match set.target_name(target) {
                    Some(name) => *named.entry(name.to_owned()).or_insert(next),
                    None => next,
                };
                n_targets += usize::from(number == next);
                number
            })
            .collect();
        let name = name(session);
        for point in &mut points[n_before..] {
            point.target = numbers[point.target];
            point.station = Some(match &point.station {
                Some(station) => format!("{name}, station {station}"),
                None => name.clone(),
            });
            point.configuration = format!("{}/{}", session + 1, point.configuration);
            point.session = Some(name.clone());
        }
    }
    let frame = sessions.first().map_or(Frame::Instrument, |set| set.frame);
    with_shared_configurations(MeasurementSet {
        frame,
        // The base of the joined set is that of its first session.
        is_levelled: sessions.first().is_some_and(|set| set.is_levelled),
        points,
    })
}

/// The targets that two sessions share: the name, and the number in each.
pub fn shared_targets<'s>(
    one: &'s MeasurementSet,
    other: &'s MeasurementSet,
) -> impl Iterator<Item = (&'s str, usize, usize)> {
    (0..one.n_targets()).filter_map(|target| {
        let name = one.target_name(target)?;
        let is_same = |number: &usize| other.target_name(*number) == Some(name);
        let number = (0..other.n_targets()).find(is_same)?;
        Some((name, target, number))
    })
}

/// Name of a session in messages. `session` is counted from 0.
pub fn name(session: usize) -> String {
    format!("session {}", session + 1)
}

/// The first row of each session in the joined set, followed by the total number of rows.
pub fn first_rows(sessions: &[MeasurementSet]) -> Vec<usize> {
    let mut rows = vec![0];
    for set in sessions {
        rows.push(rows[rows.len() - 1] + set.points.len());
    }
    rows
}

/// The same points, but all labels of one posture are replaced by its first label.
fn with_shared_configurations(mut set: MeasurementSet) -> MeasurementSet {
    let numbers = set.distinct_configurations();
    let mut first: BTreeMap<usize, &str> = BTreeMap::new();
    let labels: Vec<String> = set
        .points
        .iter()
        .map(|point| {
            let label = point.configuration.as_str();
            (*first.entry(numbers[label]).or_insert(label)).to_owned()
        })
        .collect();
    for (point, label) in set.points.iter_mut().zip(labels) {
        point.configuration = label;
    }
    set
}
