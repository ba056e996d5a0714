//! Several sessions of one robot as one set of points: each keeps its own base and its own targets, and a posture that several of them measured
//! is one configuration.

use crate::measurement::conventions::Frame;
use crate::measurement::set::MeasurementSet;
use std::collections::BTreeMap;

/// Most sessions of one job: every pair of them is compared.
pub const MAX_SESSIONS: usize = 8;

/// The points of all sessions, one session after the other, in the frame of the first. Stations, sessions, targets and places in the measuring
/// order of one session are never those of another. All sets have to be in the same frame.
pub fn joined(sessions: &[MeasurementSet]) -> MeasurementSet {
    let mut points = Vec::new();
    let mut n_targets = 0;
    for (session, set) in sessions.iter().enumerate() {
        let mut order: Vec<usize> = (0..set.points.len()).collect();
        order.sort_by_key(|row| (set.points[*row].sequence, *row));
        let n_before = points.len();
        points.extend(set.points.iter().cloned());
        for (place, row) in order.into_iter().enumerate() {
            points[n_before + row].sequence = (n_before + place) as i64;
        }
        let name = name(session);
        for point in &mut points[n_before..] {
            point.target += n_targets;
            point.station = Some(match &point.station {
                Some(station) => format!("{name}, station {station}"),
                None => name.clone(),
            });
            point.configuration = format!("{}/{}", session + 1, point.configuration);
            point.session = Some(name.clone());
        }
        n_targets += set.n_targets();
    }
    let frame = sessions.first().map_or(Frame::Instrument, |set| set.frame);
    with_shared_configurations(MeasurementSet {
        frame,
        // the base of the joined set is that of its first session
        is_levelled: sessions.first().is_some_and(|set| set.is_levelled),
        points,
    })
}

/// What messages call a session, counted from 0.
pub fn name(session: usize) -> String {
    format!("session {}", session + 1)
}

/// The first row of each session in the joined set, and after them the number of all rows.
pub fn first_rows(sessions: &[MeasurementSet]) -> Vec<usize> {
    let mut rows = vec![0];
    for set in sessions {
        rows.push(rows[rows.len() - 1] + set.points.len());
    }
    rows
}

/// The same points; labels of one posture become the one that it had first.
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
