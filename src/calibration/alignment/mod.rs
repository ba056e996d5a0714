//! Whether a measurement set can have been measured on this robot as it says: the nominal robot is laid onto the points, and where it
//! does not fit, wrong units, columns, rows and robots are tried. A set is called wrong only where one of these fits several times better;
//! an unmastered joint alone is no reason to refuse.

mod hypotheses;

pub use hypotheses::{Hypothesis, hypotheses};

use crate::identification::KinematicModel;
use crate::identification::fit::fit_least_squares;
use crate::identification::objective::{Observation, cost};
use crate::identification::parameters::{Parameter, Quantity};
use crate::identification::start::{align_in_closed_form, fit_base_and_targets};
use crate::kinematics::Robot;
use crate::measurement::{Frame, MeasurementSet, Point};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// The nominal robot fits right data of real robots to 2 to 7 mm; above this something is worth a look, rms, mm.
pub const FITS_MM: f64 = 20.0;
/// A hypothesis has to fit this many times better before a set is called wrong.
pub const BETTER: f64 = 5.0;
/// ... and to fit this well itself: with some joints unmastered nominal robots fit to some tens, rms, mm.
const EXPLAINS_MM: f64 = 50.0;
/// Points that are looked at, evenly from the whole set: enough to tell, and few enough for every upload.
const MAX_POINTS: usize = 40;
/// Equations beyond the unknowns that are needed before anything is said.
const SPARE_EQUATIONS: usize = 12;
/// Numbers of a free base with one target: nine of its rotation, three of its translation, three of the target.
const UNKNOWNS: usize = 15;

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
    /// One hypothesis fits far better: the set is to be refused.
    Wrong {
        /// `unit_suspect`, `column_suspect` or `robot_mismatch`.
        code: &'static str,
        /// The columns that it is about, as they stand in a CSV header.
        columns: Option<String>,
        /// In words, with both figures.
        detail: String,
    },
    /// Nothing explains it so well: a remark.
    Odd {
        /// `joint_offset_suspect`, `frame_suspect` or `poor_alignment`.
        code: &'static str,
        /// In words.
        detail: String,
    },
}

/// The check of every upload.
pub fn look(robot: &Robot, set: &MeasurementSet) -> Look {
    let all: Vec<Point> = of_one_target_and_station(set);
    match rms(robot, &all, set.frame, Fit::ClosedForm) {
        Some(found) if found > FITS_MM => match rms(robot, &all, set.frame, Fit::Polished) {
            Some(found) if found > FITS_MM => Look::Off(found),
            _ => Look::Fine,
        },
        _ => Look::Fine,
    }
}

/// What explains a set that fits only to `off_mm`. `others` are robots that the set may have been measured on instead.
pub fn explain(
    robot: &Robot,
    set: &MeasurementSet,
    off_mm: f64,
    others: &[(String, Robot)],
) -> Finding {
    let points = of_one_target_and_station(set);
    let tried = hypotheses(robot.links.len(), others.len())
        .into_iter()
        .filter_map(|hypothesis| {
            let changed = hypothesis.applied(&points);
            let robot = hypothesis.robot().map_or(robot, |index| &others[index].1);
            Some((
                rms(robot, &changed, set.frame, Fit::ClosedForm)?,
                hypothesis,
            ))
        });
    let best = tried.min_by(|a, b| a.0.total_cmp(&b.0));
    let mastered = with_joint_offsets(robot, &points, set.frame);
    if let Some((rms_mm, hypothesis)) = best
        && BETTER * rms_mm <= off_mm
        && rms_mm <= EXPLAINS_MM
        && mastered
            .as_ref()
            .is_none_or(|(explained_mm, _)| BETTER * rms_mm <= *explained_mm)
        && rms(robot, &points, set.frame, Fit::Thorough)
            .is_some_and(|found| found > FITS_MM && found >= BETTER * rms_mm)
    {
        let names: Vec<&str> = others.iter().map(|(name, _)| name.as_str()).collect();
        let detail = format!(
            "as it is, the nominal robot fits these points only to {off_mm:.1} mm (rms, best alignment); if {}, it fits to {rms_mm:.1} mm: {}",
            hypothesis.words(&names),
            hypothesis.hint()
        );
        return Finding::Wrong {
            code: hypothesis.code(),
            columns: hypothesis.columns(),
            detail,
        };
    }
    odd(robot, &points, set.frame, off_mm, mastered)
}

fn odd(
    robot: &Robot,
    points: &[Point],
    frame: Frame,
    off_mm: f64,
    mastered: Option<(f64, String)>,
) -> Finding {
    if let Some((rms_mm, joints)) = mastered.filter(|(rms_mm, _)| BETTER * rms_mm <= off_mm) {
        let detail = format!(
            "the nominal robot fits these points only to {off_mm:.1} mm; with joint values that are off by {joints} it fits to {rms_mm:.1} mm: an unmastered joint?"
        );
        return Finding::Odd {
            code: "joint_offset_suspect",
            detail,
        };
    }
    if frame == Frame::Base
        && let Some(rms_mm) = rms(robot, points, Frame::Instrument, Fit::Polished)
            .filter(|rms_mm| BETTER * rms_mm <= off_mm)
    {
        let detail = format!(
            "in the base frame the nominal robot fits these points only to {off_mm:.1} mm, with the base turned to {rms_mm:.1} mm: are they in the instrument's frame (frame=instrument)?"
        );
        return Finding::Odd {
            code: "frame_suspect",
            detail,
        };
    }
    let detail = format!(
        "the nominal robot fits these points only to {off_mm:.1} mm (rms, best alignment); right data fit to some millimetres"
    );
    Finding::Odd {
        code: "poor_alignment",
        detail,
    }
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

/// How much trouble is taken to place base and target.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Fit {
    /// Linear, for every upload and hypothesis.
    ClosedForm,
    /// From there by least squares.
    Polished,
    /// From many starts: before a set is called wrong.
    Thorough,
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

fn model(
    robot: &Robot,
    observations: &[Observation],
    frame: Frame,
    fit: Fit,
) -> Option<KinematicModel> {
    if 3 * observations.len() < UNKNOWNS + SPARE_EQUATIONS {
        return None;
    }
    if frame == Frame::Instrument && fit == Fit::Thorough {
        return Some(fit_base_and_targets(&robot.links, observations, 1));
    }
    let start = align_in_closed_form(&robot.links, observations, 1, frame == Frame::Base)?;
    if frame == Frame::Base || fit == Fit::ClosedForm {
        return Some(start); // with the base's rotation known it is linear, and done
    }
    Some(fit_least_squares(&start, &placing(6), observations).model)
}

/// The parameters of base (translation, then rotation: `n_base` of them) and target.
fn placing(n_base: usize) -> Vec<Parameter> {
    let base = (0..3)
        .map(Parameter::BaseTranslation)
        .chain((0..3).map(Parameter::BaseRotation));
    base.take(n_base)
        .chain((0..3).map(|axis| Parameter::Target(0, axis)))
        .collect()
}

/// rms; more where the points hardly differ in position, which any robot fits that hardly moves: metres taken for millimetres.
fn rms_of(robot: &Robot, model: &KinematicModel, observations: &[Observation]) -> f64 {
    let n = observations.len() as f64;
    let reach: f64 = robot
        .links
        .iter()
        .map(|l| (l.a_mm * l.a_mm + l.d_mm * l.d_mm).sqrt())
        .sum();
    let centre = observations
        .iter()
        .map(|o| o.position_mm)
        .sum::<Vector3<f64>>()
        / n;
    let spread = (observations
        .iter()
        .map(|o| (o.position_mm - centre).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt();
    (cost(model, observations) / n).sqrt() * (SMALL_SPREAD * reach / spread).max(1.0)
}

/// Points this close together, as a share of the arm's reach, may be in a larger unit than they seem.
const SMALL_SPREAD: f64 = 0.02;

/// rms of the nominal robot, base and target placed as well as can be; `None` where that cannot be told.
fn rms(robot: &Robot, points: &[Point], frame: Frame, fit: Fit) -> Option<f64> {
    let observations = observations(robot, points);
    let model = model(robot, &observations, frame, fit)?;
    Some(rms_of(robot, &model, &observations)).filter(|rms| rms.is_finite())
}

/// The fit with every joint's offset free, and the joints that then are off, in words.
fn with_joint_offsets(robot: &Robot, points: &[Point], frame: Frame) -> Option<(f64, String)> {
    let observations = observations(robot, points);
    let start = model(robot, &observations, frame, Fit::Polished)?;
    let offsets = (0..robot.links.len()).map(|link| Parameter::Link(link, Quantity::ThetaOffset));
    // the first joint's offset is the base's turn, unless that is known
    let free = offsets.skip(usize::from(frame == Frame::Instrument));
    let parameters: Vec<Parameter> = free
        .chain(placing(if frame == Frame::Instrument { 6 } else { 3 }))
        .collect();
    let fitted = fit_least_squares(&start, &parameters, &observations).model;
    let off = |joint: usize| {
        (fitted.links[joint].theta_offset_rad - robot.links[joint].theta_offset_rad).to_degrees()
    };
    let joints = (0..robot.links.len()).filter(|joint| off(*joint).abs() > OFFSET_DEG);
    let words: Vec<String> = joints
        .map(|joint| format!("{:+.2}° (joint {})", off(joint), joint + 1))
        .collect();
    Some((rms_of(robot, &fitted, &observations), words.join(", ")))
        .filter(|(rms, words)| rms.is_finite() && !words.is_empty())
}

/// Smaller offsets are not worth naming, degrees.
const OFFSET_DEG: f64 = 0.3;
