//! How much of the robot the poses of a set show: range of each joint, and spread of the measured points.

use crate::calibration::report::{SHOWS_LITTLE, Warning};
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::statistics::hidden_zeros::{SHOWN, hidden_zeros};
use crate::kinematics::Robot;
use crate::measurement::MeasurementSet;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// A joint that moves less than this over the whole set hardly separates the parameters of its link from those of the neighbouring links,
/// rad (20°).
const SMALL_JOINT_RANGE_RAD: f64 = 0.349;
/// Points with a smaller spread than this do not show the workspace: rms distance from their centre, as a share of the arm's reach.
const SMALL_SPREAD_PER_REACH: f64 = 0.1;

/// Joints that hardly move (numbered from 0) and their ranges, rad.
pub fn still_joints(set: &MeasurementSet) -> Vec<(usize, f64)> {
    let n_joints = set.points.first().map_or(0, |point| point.q_rad.len());
    let range_rad = |joint: usize| {
        let values = set.points.iter().map(|p| p.q_rad[joint]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    (0..n_joints)
        .map(|joint| (joint, range_rad(joint)))
        .filter(|(_, range_rad)| *range_rad < SMALL_JOINT_RANGE_RAD)
        .collect()
}

/// The rms distance of the points from the centre of their station's points, and the arm's reach, both in mm; `None` unless the spread is
/// small. Each station has its own frame, so distances between points of two stations show nothing about the robot.
pub fn narrow_cloud_mm(robot: &Robot, set: &MeasurementSet) -> Option<(f64, f64)> {
    let lengths = robot
        .links
        .iter()
        .map(|l| (l.a_mm * l.a_mm + l.d_mm * l.d_mm).sqrt());
    let reach_mm: f64 = lengths.sum();
    let mut stations: BTreeMap<Option<&str>, Vec<Vector3<f64>>> = BTreeMap::new();
    for point in &set.points {
        let of_station = stations.entry(point.station.as_deref()).or_default();
        of_station.push(point.position_mm);
    }
    let squares = stations.values().map(|positions_mm| {
        let centre = positions_mm.iter().sum::<Vector3<f64>>() / positions_mm.len() as f64;
        let away = positions_mm.iter().map(|p| (p - centre).norm_squared());
        away.sum::<f64>()
    });
    let spread_mm = (squares.sum::<f64>() / set.points.len() as f64).sqrt();
    (spread_mm < SMALL_SPREAD_PER_REACH * reach_mm).then_some((spread_mm, reach_mm))
}

/// Reason why a session is no evidence: its points have a small spread, a joint other than the last one hardly moves, or base and targets
/// absorb a joint's zero. A changed robot fits such points as well as an unchanged one. `placed` is the robot whose base and targets were
/// fitted to these points, if they were.
pub fn shows_little(
    robot: &Robot,
    set: &MeasurementSet,
    placed: Option<(&KinematicModel, &[Observation])>,
) -> Option<Warning> {
    let mut reasons = Vec::new();
    if let Some((spread_mm, reach_mm)) = narrow_cloud_mm(robot, set) {
        reasons.push(format!(
            "its points lie within {spread_mm:.0} mm (rms) of their centre; {:.0} mm are needed, a tenth of the arm's {reach_mm:.0} mm",
            SMALL_SPREAD_PER_REACH * reach_mm
        ));
    }
    let last = robot.links.len().saturating_sub(1);
    let still: Vec<String> = still_joints(set)
        .into_iter()
        .filter(|(joint, _)| *joint < last)
        .map(|(joint, range_rad)| format!("{} ({:.1}°)", joint + 1, range_rad.to_degrees()))
        .collect();
    if !still.is_empty() {
        reasons.push(format!(
            "these joints move less than 20°: {}",
            still.join(", ")
        ));
    }
    let hidden = placed.map_or(vec![], |(model, points)| {
        let mut stations: BTreeMap<Option<&str>, Vec<&Observation>> = BTreeMap::new();
        for (point, observation) in set.points.iter().zip(points) {
            let of_station = stations.entry(point.station.as_deref()).or_default();
            of_station.push(observation);
        }
        hidden_zeros(model, &stations.into_values().collect::<Vec<_>>())
    });
    let hidden: Vec<String> = hidden
        .iter()
        .map(|zero| format!("{} ({:.0} %)", zero.joint + 1, 100.0 * zero.share))
        .collect();
    if !hidden.is_empty() {
        reasons.push(format!(
            "base and reflector are placed on these points, which then show too little of what the zeros of these joints do around them: {} ({:.0} % are needed: turn the last joints by 60° and more, \
             at poses that are turned against each other)",
            hidden.join(", "),
            100.0 * SHOWN
        ));
    }
    (!reasons.is_empty()).then(|| {
        let detail = format!(
            "the session is no evidence: {}. A robot that has changed may fit it as well: spread the poses over the workspace and move every joint",
            reasons.join("; ")
        );
        Warning::new(SHOWS_LITTLE, detail)
    })
}
