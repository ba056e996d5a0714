//! Result of an upload check, its thresholds, and the points that it uses.

use crate::identification::model::objective::Observation;
use crate::kinematics::{JointMap, Robot};
use crate::measurement::{MeasurementSet, Point};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Largest rms of a set that fits, as a share of the reach. With the zeros of unmastered joints fitted, the nominal robot fits correct data
/// of real robots to 0.5 % of its reach. Above twice that, a set is examined. It is refused if no hypothesis explains it, not even other
/// joint zeros.
pub const FITS: f64 = 0.01;

/// A set is called wrong only if a hypothesis fits better by this factor.
pub const BETTER: f64 = 5.0;

/// A hypothesis with an rms within this share of the reach is reported if it fits [`BETTER`] times better. If a frame is off by less than
/// this, it is a poorly known base frame and not another frame.
pub const NEAR_FIT_PER_REACH: f64 = 0.02;

/// Largest zero error of a joint that was never mastered, rad (45°). A larger one is another convention or another frame.
pub const UNMASTERED_RAD: f64 = PI / 4.0;

/// Maximum number of points that are examined, evenly selected from the whole set. This is enough for a decision and fast enough for every
/// upload.
const MAX_POINTS: usize = 40;

/// Probable cause of a misfit.
#[derive(Clone, Debug, PartialEq)]
pub enum Explanation {
    /// The set is refused, unless the caller insists.
    Refusal(Suspicion),
    /// The set is accepted with a warning.
    Warning {
        /// `joint_offset_suspect`, `frame_suspect` or `poor_alignment`.
        code: &'static str,
        /// In words.
        detail: String,
    },
}

/// The reason why a set is refused.
#[derive(Clone, Debug, PartialEq)]
pub struct Suspicion {
    /// One of [`SUSPICIONS`].
    pub code: &'static str,
    /// Columns concerned, as named in a CSV header.
    pub columns: Option<String>,
    /// Text with both figures and the remedy.
    pub detail: String,
    /// The joint map that the robot should have.
    pub joint_map: Option<JointMap>,
}

impl Suspicion {
    /// Message for a set that was refused.
    pub fn refusal(&self) -> String {
        format!(
            "{}{} To keep it all the same, insist on {}: no release then rests on it",
            self.detail,
            if self.detail.ends_with('?') { "" } else { "." },
            self.code
        )
    }
}

/// Points of the station with the most points. Other stations have other unknown bases.
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

/// Evenly selected points, with targets numbered from 0. A target with one point gives no information and is left out.
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
        let target = seen.binary_search(&p.target).ok()?;
        let q_rad = robot.q_model_rad(&p.q_rad);
        Some(Observation::at(q_rad, p.position_mm, target))
    };
    some.iter().filter_map(observation).collect()
}

/// Number of targets that the points belong to.
pub(super) fn n_targets(observations: &[Observation]) -> usize {
    observations.iter().map(|o| o.target + 1).max().unwrap_or(0)
}
