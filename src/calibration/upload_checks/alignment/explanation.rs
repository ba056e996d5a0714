//! What a check of an upload finds, its thresholds, and the points that it looks at.

use crate::identification::objective::Observation;
use crate::kinematics::{JointMap, Robot};
use crate::measurement::{MeasurementSet, Point};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// The nominal robot fits right data of real robots, unmastered joints placed, to 0.5 % of its reach; above twice that something is worth a
/// look, rms as a share of the reach. A set that nothing explains, other joint zeros included, is refused from there on.
pub const FITS: f64 = 0.01;

/// A hypothesis has to fit this many times better before a set is called wrong.
pub const BETTER: f64 = 5.0;

/// A hypothesis that comes within this share of the reach is told, if it fits [`BETTER`] times better. Positions that are in another frame by
/// less than this are a base frame that is known badly.
pub const COMES_NEAR: f64 = 0.02;

/// A joint that was never mastered may be off by so much, rad (45°); more is another convention, or another frame.
pub const UNMASTERED_RAD: f64 = PI / 4.0;

/// Points that are looked at, evenly from the whole set: enough to tell, and few enough for every upload.
const MAX_POINTS: usize = 40;

/// What is probably wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Explanation {
    /// The set is to be refused, unless the caller insists.
    Refusal(Suspicion),
    /// It is accepted with a warning.
    Warning {
        /// `joint_offset_suspect`, `frame_suspect` or `poor_alignment`.
        code: &'static str,
        /// In words.
        detail: String,
    },
}

/// Why a set is refused.
#[derive(Clone, Debug, PartialEq)]
pub struct Suspicion {
    /// One of [`SUSPICIONS`].
    pub code: &'static str,
    /// The columns that it is about, as they stand in a CSV header.
    pub columns: Option<String>,
    /// In words, with both figures and what to do.
    pub detail: String,
    /// The joint map that the robot should have.
    pub joint_map: Option<JointMap>,
}

impl Suspicion {
    /// What is said where the set is not kept.
    pub fn refusal(&self) -> String {
        format!(
            "{}{} To keep it as it is all the same: ?insist={}, and no release rests on it",
            self.detail,
            if self.detail.ends_with('?') { "" } else { "." },
            self.code
        )
    }
}

/// The points of the station that has most: for the others the base is unknown anew.
pub(super) fn of_one_station(set: &MeasurementSet) -> Vec<Point> {
    let mut stations: BTreeMap<Option<&str>, Vec<&Point>> = BTreeMap::new();
    for point in &set.points {
        let of_station = stations.entry(point.station.as_deref()).or_default();
        of_station.push(point);
    }
    let largest =
        stations
            .into_values()
            .reduce(|largest, station| match station.len() > largest.len() {
                true => station,
                false => largest,
            });
    largest.unwrap_or_default().into_iter().cloned().collect()
}

/// Some of the points, evenly taken, the targets numbered from 0. A target with one point shows nothing but itself and is left out.
pub(super) fn observations(robot: &Robot, points: &[Point]) -> Vec<Observation> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let some: Vec<&Point> = points.iter().step_by(step).collect();
    let mut n_of_target: BTreeMap<usize, usize> = BTreeMap::new();
    for point in &some {
        *n_of_target.entry(point.target).or_default() += 1;
    }
    n_of_target.retain(|_, n| *n > 1);
    let seen: Vec<usize> = n_of_target.into_keys().collect();
    let observation = |p: &&Point| {
        Some(Observation {
            q_rad: robot.q_model_rad(&p.q_rad),
            position_mm: p.position_mm,
            target: seen.binary_search(&p.target).ok()?,
            weight: 1.0,
            whitening: None,
            rotation: None,
        })
    };
    some.iter().filter_map(observation).collect()
}

/// Number of targets that the points are of.
pub(super) fn n_targets(observations: &[Observation]) -> usize {
    observations.iter().map(|o| o.target + 1).max().unwrap_or(0)
}
