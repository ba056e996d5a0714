//! What can be said of a measurement set when it arrives. Remarks only: a set that is too small to identify from may still verify,
//! and what is said of that is what a job of kind verify would say.

use crate::calibration::report::Warning;
use crate::calibration::verify::too_small_to_verify;
use crate::calibration::{CalibrationRequest, Error, check};
use crate::kinematics::Robot;
use crate::measurement::{Frame, MeasurementSet, Point, split};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A joint that moves less than this over the whole set hardly tells its link from its neighbours, rad (20°).
const SMALL_JOINT_RANGE_RAD: f64 = 0.349;
/// Measured points this close together (rms distance from their centre, as a share of the arm's reach) do not show the workspace.
const SMALL_CLOUD: f64 = 0.1;

/// Remarks on a set of `robot`, for its summary.
pub fn warnings(robot: &Robot, set: &MeasurementSet) -> Vec<Warning> {
    let mut warnings = Vec::new();
    warnings.extend(too_small(robot, set));
    warnings.extend(duplicates(set));
    warnings.extend(still_joints(set));
    warnings.extend(narrow_cloud(robot, set));
    if split::has_column(set)
        && let Err(error) = split::by_column(set)
    {
        warnings.push(Warning {
            code: "bad_subset",
            detail: error.to_string(),
            rows: vec![],
        });
    }
    warnings
}

fn warning(code: &'static str, detail: String) -> Warning {
    Warning {
        code,
        detail,
        rows: vec![],
    }
}

/// What a default job would be refused for, if it is a lack of equations, and what the set can serve for all the same.
fn too_small(robot: &Robot, set: &MeasurementSet) -> Option<Warning> {
    let request = CalibrationRequest::new(robot.clone(), set.clone());
    let Err(Error::Unusable {
        code: "under_determined",
        detail,
    }) = check(&request)
    else {
        return None;
    };
    let serves = match (too_small_to_verify(&request), set.frame) {
        ([_, None], _) => {
            "kept: too small to identify from, it can serve to verify (a job of kind verify)".into()
        }
        ([None, Some(_)], Frame::Base) => {
            "kept: too small to identify from, and to verify a parameter set on whose base and target are fitted anew, as those of model \
             complete are; it can serve to verify one of model paper that was identified in the base frame (a job of kind verify)"
                .into()
        }
        ([_, Some(why)], _) => {
            format!("kept, but too small to identify from and to verify on: to verify, {why}; to identify")
        }
    };
    Some(warning("under_determined", format!("{serves}: {detail}")))
}

fn duplicates(set: &MeasurementSet) -> Option<Warning> {
    // one pose of the arm is one configuration, by the file or by joint values that agree; and who labels equal poses apart repeats them too
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
        "{} rows repeat the joint values of an earlier row; they tell about repeatability, not about the robot's geometry",
        rows.len()
    );
    (!rows.is_empty()).then_some(Warning {
        code: "duplicate_poses",
        detail,
        rows,
    })
}

fn still_joints(set: &MeasurementSet) -> Option<Warning> {
    let n_joints = set.points.first()?.q_rad.len();
    let range = |joint: usize| {
        let values = set.points.iter().map(|p| p.q_rad[joint]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    let still: Vec<String> = (0..n_joints)
        .filter(|joint| range(*joint) < SMALL_JOINT_RANGE_RAD)
        .map(|joint| format!("{} ({:.1}°)", joint + 1, range(joint).to_degrees()))
        .collect();
    let detail = format!(
        "joints that move less than 20° over the whole set: {}; their parameters will be uncertain",
        still.join(", ")
    );
    (!still.is_empty()).then(|| warning("joint_hardly_moves", detail))
}

fn narrow_cloud(robot: &Robot, set: &MeasurementSet) -> Option<Warning> {
    let reach: f64 = robot
        .links
        .iter()
        .map(|l| (l.a_mm * l.a_mm + l.d_mm * l.d_mm).sqrt())
        .sum();
    let n = set.points.len() as f64;
    let centre = set
        .points
        .iter()
        .map(|p| p.position_mm)
        .sum::<Vector3<f64>>()
        / n;
    let spread = (set
        .points
        .iter()
        .map(|p| (p.position_mm - centre).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt();
    let detail = format!(
        "the points lie within {spread:.0} mm (rms) of their centre, the arm reaches {reach:.0} mm; spread the poses evenly over the workspace"
    );
    (spread < SMALL_CLOUD * reach).then(|| warning("poses_not_spread", detail))
}
