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

/// One target on one station, the one with most points: for the others base or target are unknown anew.
pub(super) fn of_one_target_and_station(set: &MeasurementSet) -> Vec<Point> {
    let mut groups: BTreeMap<(usize, Option<&str>), Vec<&Point>> = BTreeMap::new();
    for point in &set.points {
        groups
            .entry((point.target, point.station.as_deref()))
            .or_default()
            .push(point);
    }
    let largest = groups.into_values().reduce(|largest, group| {
        if group.len() > largest.len() {
            group
        } else {
            largest
        }
    });
    largest
        .unwrap_or_default()
        .into_iter()
        .map(|point| Point {
            target: 0,
            ..point.clone()
        })
        .collect()
}

pub(super) fn observations(robot: &Robot, points: &[Point]) -> Vec<Observation> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let observation = |p: &Point| Observation {
        q_rad: robot.q_model_rad(&p.q_rad),
        position_mm: p.position_mm,
        target: 0,
        weight: 1.0,
        whitening: None,
        rotation: None,
    };
    points.iter().step_by(step).map(observation).collect()
}
