//! Whether a measurement set can have been measured on this robot as it says: the nominal robot is laid onto the points, and where it
//! does not fit, another frame, makers' joint conventions, wrong units, columns, rows and robots are tried. A set is refused where one of
//! these fits several times better, or where nothing comes near; an unmastered joint alone is no reason to refuse.

mod affine;
mod convention;
mod fitting;
mod hypotheses;
mod joint_maps;
mod suspect;

pub use hypotheses::{Hypothesis, hypotheses};

use crate::identification::objective::Observation;
use crate::kinematics::{JointMap, Robot};
use crate::measurement::{Frame, MeasurementSet, Point};
use fitting::{placed_thoroughly, quickly_placed, reach_mm};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use suspect::Suspect;

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

/// How a set looks when it arrives.
#[derive(Clone, Debug, PartialEq)]
pub enum Look {
    /// The nominal robot fits, or there are too few points to tell.
    Fine,
    /// It does not: rms with the best alignment, mm.
    Off(f64),
}

/// What is probably wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// The set is to be refused, unless the caller insists.
    Wrong(Suspicion),
    /// A remark.
    Odd {
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
            "{}. To keep it as it is all the same: ?insist={}, and no release rests on it",
            self.detail, self.code
        )
    }
}

/// Codes of refusals by suspicion: a caller may insist on the upload all the same.
pub const SUSPICIONS: [&str; 6] = [
    "unit_suspect",
    "column_suspect",
    "frame_suspect",
    "joint_map_suspect",
    "robot_mismatch",
    "poor_alignment",
];

/// The check of every upload.
pub fn look(robot: &Robot, set: &MeasurementSet) -> Look {
    let observations = observations(robot, &of_one_target_and_station(set));
    let Some(quick) = quickly_placed(&robot.links, &observations, set.frame) else {
        return Look::Fine;
    };
    let fits_mm = FITS * reach_mm(&robot.links, &observations);
    if quick.rms_mm <= fits_mm {
        return Look::Fine;
    }
    match placed_thoroughly(&robot.links, &observations, set.frame) {
        Some(found) if found.rms_mm <= fits_mm => Look::Fine,
        Some(found) => Look::Off(found.rms_mm),
        None => Look::Off(quick.rms_mm),
    }
}

/// What explains a set that fits only to `off_mm`. `others` are robots that the set may have been measured on instead.
pub fn explain(
    robot: &Robot,
    set: &MeasurementSet,
    off_mm: f64,
    others: &[(String, Robot)],
) -> Finding {
    let suspect = Suspect::new(robot, set, off_mm);
    let zeros = suspect.zeros(set.frame);
    let best = suspect.best_hypothesis(others);
    // whatever joints that were never mastered explain nearly as well is none of the others' fault
    let is_unmastered = |rms_mm: f64| {
        zeros.as_ref().is_some_and(|zeros| {
            zeros.rms_mm <= suspect.fits_mm
                && zeros.largest_rad() <= UNMASTERED_RAD
                && zeros.rms_mm < BETTER * rms_mm
        })
    };
    let explains = |rms_mm: f64| BETTER * rms_mm <= off_mm && !is_unmastered(rms_mm);
    let best = best.filter(|best| explains(best.rms_mm));
    // joint 1's zero, quarter turns away, looks like a frame that is turned: frames go before zeros
    if let Some(best) = best.as_ref().filter(|best| best.rms_mm <= suspect.fits_mm)
        && !best.what.is_turned()
    {
        return Finding::Wrong(suspect.told(best, others));
    }
    if set.frame == Frame::Base
        && let Some(free) = suspect
            .in_another_frame()
            .filter(|free| explains(free.rms_mm))
    {
        return suspect.frame(&free, "");
    }
    if let Some(best) = best.as_ref().filter(|best| best.rms_mm <= suspect.fits_mm) {
        return Finding::Wrong(suspect.told(best, others));
    }
    if let Some(found) = suspect
        .convention_and_zeros(set.frame)
        .filter(|found| explains(found.rms_mm))
    {
        return Finding::Wrong(suspect.told(&found, others));
    }
    if let Some(best) = best.filter(|best| best.rms_mm <= suspect.near_mm) {
        return Finding::Wrong(suspect.told(&best, others));
    }
    if let Some(zeros) = zeros
        .as_ref()
        .filter(|zeros| zeros.rms_mm <= suspect.near_mm && BETTER * zeros.rms_mm <= off_mm)
        && let Some(finding) = suspect.unmastered(zeros)
    {
        return finding;
    }
    if set.frame == Frame::Base
        && let Some(finding) = suspect.frame_and_joints()
    {
        return finding;
    }
    suspect.poor(zeros.as_ref())
}

/// One target on one station, the one with most points: for the others base or target are unknown anew.
fn of_one_target_and_station(set: &MeasurementSet) -> Vec<Point> {
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

fn observations(robot: &Robot, points: &[Point]) -> Vec<Observation> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let observation = |p: &Point| Observation {
        q_rad: robot.q_model_rad(&p.q_rad),
        position_mm: p.position_mm,
        target: 0,
        weight: 1.0,
    };
    points.iter().step_by(step).map(observation).collect()
}
