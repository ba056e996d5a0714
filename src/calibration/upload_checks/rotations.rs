//! Checks whether the rotations of poses were read in the right convention. Base and target are rotated for the best fit of the nominal robot, for
//! the stated convention and for all others.

use crate::identification::hand_eye::base_and_target_rotation;
use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Robot, t_base_flange};
use crate::measurement::{MeasurementSet, Point, RotationConvention};
use nalgebra::Rotation3;
use std::collections::BTreeMap;

/// Maximum number of poses that are used.
const MAX_POSES: usize = 100;
/// Minimum number of poses. With three poses, six unknowns would be fitted to nine equations.
const FEWEST_POSES: usize = 4;
/// With the right convention and no joint far off, half of the poses fit to this angle, rad (1°).
const FITS_RAD: f64 = std::f64::consts::PI / 180.0;
/// Another reading has to fit better by this factor.
const BETTER: f64 = 5.0;

/// Code of the refusal.
pub const ROTATION_SUSPECT: &str = "rotation_suspect";

/// One way to read the rotations of a file, and how well the nominal robot then fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Its name: a convention, or the operation on the rotations.
    pub name: String,
    /// Median angle between measured and predicted targets, rad.
    pub median_rad: f64,
}

/// Why the rotations of a set seem to be read wrongly; `None` if they fit, or if no other reading fits better.
pub fn suspicion(robot: &Robot, set: &MeasurementSet) -> Option<String> {
    let poses = poses(set, |p| p.rotation.is_some());
    let stated: Option<Vec<Rotation3<f64>>> = poses.iter().map(|p| p.rotation).collect();
    let stated = stated?;
    let own_rad = median_rad(robot, &poses, &stated)?;
    if own_rad <= FITS_RAD {
        return None;
    }
    let are_angles = poses.iter().all(|p| p.rotation_angles_rad.is_some());
    let inverse = "the inverse rotation (the measuring frame as the target sees it)";
    let mut others = vec![(
        match are_angles {
            true => inverse.to_owned(),
            // x, y, z, w read as w, x, y, z gives the inverse rotation between two fixed quarter turns, which base and target absorb: the fit is the
            // same
            false => format!("{inverse}, or as quaternions in the order x, y, z, w,"),
        },
        stated.iter().map(Rotation3::inverse).collect::<Vec<_>>(),
    )];
    if are_angles {
        others.extend(by_conventions(&poses));
    }
    let best = best(robot, &poses, others)?;
    if BETTER * best.median_rad > own_rad {
        return None;
    }
    Some(format!(
        "the rotations do not fit this robot as they were read: half of the poses are off by more than {:.2}°. Read as {} they fit to {:.2}°: say so, or \
         write them as stated",
        own_rad.to_degrees(),
        best.name,
        best.median_rad.to_degrees()
    ))
}

/// The convention with which the angles of a set fit the robot best; `None` if there are too few poses.
pub fn best_convention(robot: &Robot, set: &MeasurementSet) -> Option<Reading> {
    let poses = poses(set, |p| p.rotation_angles_rad.is_some());
    best(robot, &poses, by_conventions(&poses))
}

/// Poses of the target and station with the most poses, at most [`MAX_POSES`].
fn poses(set: &MeasurementSet, is_pose: impl Fn(&Point) -> bool) -> Vec<&Point> {
    let mut groups: BTreeMap<(usize, Option<&str>), Vec<&Point>> = BTreeMap::new();
    for point in set.points.iter().filter(|p| is_pose(p)) {
        let key = (point.target, point.station.as_deref());
        groups.entry(key).or_default().push(point);
    }
    let largest = groups
        .into_values()
        .max_by_key(Vec::len)
        .unwrap_or_default();
    let step = largest.len().div_ceil(MAX_POSES).max(1);
    largest.into_iter().step_by(step).collect()
}

fn by_conventions(poses: &[&Point]) -> Vec<(String, Vec<Rotation3<f64>>)> {
    let read = |convention: RotationConvention| {
        let angles = poses.iter().filter_map(|p| p.rotation_angles_rad);
        let rotations = angles.map(|angles| convention.rotation(&angles)).collect();
        (format!("rotation={convention}"), rotations)
    };
    RotationConvention::all().into_iter().map(read).collect()
}

fn best(
    robot: &Robot,
    poses: &[&Point],
    readings: Vec<(String, Vec<Rotation3<f64>>)>,
) -> Option<Reading> {
    let reading = |(name, rotations): (String, Vec<Rotation3<f64>>)| {
        let median_rad = median_rad(robot, poses, &rotations)?;
        Some(Reading { name, median_rad })
    };
    let fits = readings.into_iter().filter_map(reading);
    fits.min_by(|a, b| a.median_rad.total_cmp(&b.median_rad))
}

/// Median angle of the poses after base and target are rotated for the best fit, rad.
fn median_rad(robot: &Robot, poses: &[&Point], rotations: &[Rotation3<f64>]) -> Option<f64> {
    if poses.len() < FEWEST_POSES || poses.len() != rotations.len() {
        return None;
    }
    let flange = |p: &&Point| t_base_flange(&robot.links, &robot.q_model_rad(&p.q_rad)).rotation;
    let pairs: Vec<_> = poses
        .iter()
        .map(flange)
        .zip(rotations.iter().copied())
        .collect();
    let (base, target) = base_and_target_rotation(&pairs)?;
    let angle = |(flange, measured): &(Rotation3<f64>, Rotation3<f64>)| {
        rotation_log(&((base * flange * target).inverse() * measured)).norm()
    };
    let mut angles: Vec<f64> = pairs.iter().map(angle).collect();
    angles.sort_by(f64::total_cmp);
    angles.get(angles.len() / 2).copied()
}
