//! Checks of a measurement set when it is uploaded. They only warn: a set that is too small for an identification may be used for a
//! verification. The message then states what a verification would find.

pub mod alignment;
pub mod rotations;

use crate::calibration::report::Warning;
use crate::calibration::upload_checks::alignment::{Alignment, align};
use crate::calibration::validation::coverage;
use crate::calibration::validation::enough_points::{Serves, serves};
use crate::calibration::{CalibrationRequest, Error, check};
use crate::kinematics::Robot;
use crate::kinematics::rotation::within_half_a_turn;
use crate::measurement::{Frame, MeasurementSet, Point, split};
use std::collections::{BTreeMap, BTreeSet};

/// A joint that moved by more than this moved the target by more than an instrument's resolution, rad (1°).
const MOVED_RAD: f64 = 0.0175;

/// Warnings for the uploader of a set. The set is stored despite them.
pub fn warnings(robot: &Robot, set: &MeasurementSet) -> Vec<Warning> {
    let mut warnings = Vec::new();
    warnings.extend(too_small(robot, set));
    warnings.extend(duplicates(set));
    warnings.extend(stale_positions(set));
    warnings.extend(still_joints(set));
    warnings.extend(narrow_cloud(robot, set));
    if split::has_column(set)
        && let Err(error) = split::by_column(set)
    {
        warnings.push(Warning::new("bad_subset", error.to_string()));
    }
    warnings.extend(outside_limits(robot, set));
    warnings
}

/// Warning if a default job would be refused for a lack of equations. It also says what the set can be used for.
fn too_small(robot: &Robot, set: &MeasurementSet) -> Option<Warning> {
    let request = CalibrationRequest::new(robot.clone(), set.clone());
    let Err(Error::Unusable {
        code: "under_determined",
        detail,
    }) = check(&request)
    else {
        return None;
    };
    if let Alignment::Misses(rms_mm) = align(robot, set) {
        let detail = format!(
            "kept, but too small to identify from, and as it was read it does not fit this robot ({rms_mm:.1} mm rms): a verification would find \
             that, and the robot would have to be checked: {detail}"
        );
        return Some(Warning::new("under_determined", detail));
    }
    let (refit, of_which) = match set.frame {
        Frame::Instrument => (true, "that was identified in the instrument's frame"),
        Frame::Base => (false, "that was identified in the base frame"),
    };
    let of_targets = match set.n_targets() {
        1 => String::new(),
        n => format!(" with {n} targets or more"),
    };
    let serves = match serves(&request, refit) {
        Serves::Evidence => format!(
            "kept: too small to identify from, it can serve to verify a parameter set {of_which}{of_targets}"
        ),
        Serves::Scores(why) => format!(
            "kept: too small to identify from; a verification scores a parameter set on it, but {why}"
        ),
        Serves::Nothing(why) => {
            format!(
                "kept, but too small to identify from and to verify on: to verify, {why}; to identify"
            )
        }
    };
    Some(Warning::new(
        "under_determined",
        format!("{serves}: {detail}"),
    ))
}

fn duplicates(set: &MeasurementSet) -> Option<Warning> {
    // A row repeats a pose if its label or its joint values agree. Equal joint values with different labels are repeats too.
    let (mut poses, mut values) = (BTreeSet::new(), BTreeSet::new());
    let mut is_new = |p: &Point| {
        let value: Vec<i64> = p.q_rad.iter().map(|q| (q * 1e5).round() as i64).collect();
        let (pose, value) = (
            poses.insert((p.target, p.configuration.clone())),
            values.insert((p.target, value)),
        );
        pose && value
    };
    let rows: Vec<usize> = set
        .points
        .iter()
        .enumerate()
        .filter(|(_, p)| !is_new(p))
        .map(|(row, _)| row)
        .collect();
    let detail = format!(
        "{} the joint values of an earlier row; that tells about repeatability, not about the robot's geometry",
        match rows.len() {
            1 => "1 row repeats".to_owned(),
            n => format!("{n} rows repeat"),
        }
    );
    (!rows.is_empty()).then_some(Warning {
        code: "duplicate_poses",
        detail,
        rows,
    })
}

/// Warning about rows with exactly the same position as an earlier row although a joint has moved. An instrument that lost its target
/// repeats its last reading.
fn stale_positions(set: &MeasurementSet) -> Option<Warning> {
    let mut seen: BTreeMap<(usize, [u64; 3]), usize> = BTreeMap::new();
    let mut rows = Vec::new();
    for (row, point) in set.points.iter().enumerate() {
        let position = point.position_mm.map(f64::to_bits).into();
        let first = *seen.entry((point.target, position)).or_insert(row);
        let joints = point.q_rad.iter().zip(&set.points[first].q_rad);
        let moved_rad = joints.map(|(a, b)| within_half_a_turn(a - b).abs());
        let moved_rad = moved_rad.fold(0.0, f64::max);
        if moved_rad > MOVED_RAD {
            rows.push(row);
        }
    }
    let detail = format!(
        "{} rows have exactly the position of an earlier row although joints have moved: did the instrument lose its target?",
        rows.len()
    );
    (rows.len() > 1).then_some(Warning {
        code: "position_repeated",
        detail,
        rows,
    })
}

fn still_joints(set: &MeasurementSet) -> Option<Warning> {
    let still: Vec<String> = coverage::still_joints(set)
        .into_iter()
        .map(|(joint, range_rad)| format!("{} ({:.1}°)", joint + 1, range_rad.to_degrees()))
        .collect();
    let detail = format!(
        "joints that move less than 20° over the whole set: {}; their parameters will be uncertain",
        still.join(", ")
    );
    (!still.is_empty()).then(|| Warning::new("joint_hardly_moves", detail))
}

fn narrow_cloud(robot: &Robot, set: &MeasurementSet) -> Option<Warning> {
    let (spread_mm, reach_mm) = coverage::narrow_cloud_mm(robot, set)?;
    let detail = format!(
        "the points lie within {spread_mm:.0} mm (rms) of their centre, the arm reaches {reach_mm:.0} mm; spread the poses evenly over the workspace"
    );
    Some(Warning::new("poses_not_spread", detail))
}

fn outside_limits(robot: &Robot, set: &MeasurementSet) -> Option<Warning> {
    // Limits and values both use the controller's convention.
    let joint_outside = |point: &Point| {
        let mut joints = robot.joint_limits_rad.iter().zip(&point.q_rad);
        joints.position(|(limits, q)| limits.is_some_and(|(lo, hi)| *q < lo || *q > hi))
    };
    let rows = set.points.iter().enumerate();
    let outside: Vec<(usize, usize)> = rows
        .filter_map(|(row, point)| Some((row, joint_outside(point)?)))
        .collect();
    let &(row, joint) = outside.first()?;
    let detail = format!(
        "{} outside the joint limits, first row {row}: joint {} at {:.3}°; degrees and radians mixed up?",
        match outside.len() {
            1 => "1 row lies".to_owned(),
            n => format!("{n} rows lie"),
        },
        joint + 1,
        set.points[row].q_rad[joint].to_degrees()
    );
    Some(Warning {
        code: "outside_joint_limits",
        detail,
        rows: outside.into_iter().map(|(row, _)| row).collect(),
    })
}
