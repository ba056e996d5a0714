//! Checks whether the rotations of poses were read in the right convention and belong to the positions of their rows. The nominal robot is
//! placed by the positions. The target is then rotated for the best fit, for the stated convention and for all others.

use crate::calibration::upload_checks::alignment::{
    Alignment, align, base_rotation, links_with_fitted_zeros,
};
use crate::identification::least_squares::hand_eye::{
    angle_rad, base_and_target_rotation, robustly, target_rotation,
};
use crate::kinematics::{Link, Robot, t_base_flange};
use crate::measurement::{Frame, MeasurementSet, Point, RotationConvention};
use nalgebra::{Quaternion, Rotation3, UnitQuaternion};
use std::collections::BTreeMap;

/// Maximum number of poses that are used.
const MAX_POSES: usize = 100;
/// Minimum number of poses, for a base that the positions determine and for one that they do not. In the first case only the target's
/// rotation is unknown. In the second case there are six unknowns, and three poses would give only nine equations.
const MIN_POSES: usize = 3;
const MIN_WITHOUT_BASE: usize = 4;
/// With the right convention and no joint far off, four of five poses fit within this angle, rad (1°).
const FITS_RAD: f64 = std::f64::consts::PI / 180.0;
/// If a fifth of the poses are off by more than this, the rotations are wrong or a joint is unmastered, rad (5°).
pub const OFF_RAD: f64 = 5.0 * FITS_RAD;
/// Four of five angles are below this multiple of a stated standard deviation of one component. From noise alone, they are below 2.2 times.
const STATED_STDS: f64 = 4.0;
/// Rotations that fit within this angle were read correctly, rad (0.02°). Smaller differences are noise, or rounding where several
/// conventions give the same rotation.
const NOISE_RAD: f64 = 0.02 * FITS_RAD;
/// Another reading has to fit better by this factor.
const MIN_IMPROVEMENT: f64 = 5.0;

/// One way to read the rotations of a file, and how well the nominal robot then fits.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Its name: a convention, or the operation on the rotations.
    pub name: String,
    /// 80th percentile of the angles between measured and predicted targets, rad.
    pub most_rad: f64,
}

/// Why the rotations of a set seem to be wrong; `None` if they fit the robot.
pub fn suspicion(robot: &Robot, set: &MeasurementSet) -> Option<String> {
    let poses = poses(set, |p| p.rotation.is_some());
    let stated: Option<Vec<Rotation3<f64>>> = poses.iter().map(|p| p.rotation).collect();
    let stated = stated?;
    let placed = Placed::nominal(robot, set, &poses);
    let own_rad = placed.most_rad(&poses, &stated)?;
    let std_rad = set.stated_rotation_std_rad();
    let (fits_rad, off_rad) = (
        FITS_RAD.max(STATED_STDS * std_rad),
        OFF_RAD.max(STATED_STDS * std_rad),
    );
    // If the target rotates little, even a wrong convention is off by little.
    let another = in_another_reading(&placed, &poses, &stated, own_rad, std_rad);
    if own_rad <= fits_rad {
        return another;
    }
    if let Some(most_rad) = fit_of_inverse_poses(robot, set).filter(|rad| *rad <= fits_rad) {
        return Some(format!(
            "the poses fit this robot if they are inverted, positions and rotations (four of five to {:.2}°): a camera on the arm that sees a fixed board \
             writes such poses. Say inverse_poses=true (--inverse-poses) with frame=instrument; if that was said, leave it out",
            most_rad.to_degrees()
        ));
    }
    if another.is_some() {
        return another;
    }
    let off = off_by(own_rad);
    if own_rad <= off_rad || placed.base.is_none() {
        return None;
    }
    // An unmastered joint rotates the flange too.
    let with_zeros = Placed::with_fitted_zeros(robot, set, &poses);
    let fits = with_zeros.and_then(|placed| placed.most_rad(&poses, &stated));
    if fits.is_some_and(|most_rad| most_rad <= off_rad) {
        return None;
    }
    let reversed = Placed::with_last_joint_reversed(robot, set, &poses);
    let n_joints = robot.links.len();
    if reversed
        .most_rad(&poses, &stated)
        .is_some_and(|most_rad| most_rad <= fits_rad)
    {
        return Some(format!(
            "{off}. They fit with joint {n_joints} counted the other way round: turn it at the controller, compare with the nominal robot, and correct the \
             robot's joint_map"
        ));
    }
    Some(format!(
        "{off}, and no other convention fits them. Do positions and rotations of a row belong together, and are both in the same frame?"
    ))
}

/// Another reading of the file's rotations that fits an identified robot much better; `None` if there is none.
pub fn better_reading(robot: &Robot, set: &MeasurementSet) -> Option<String> {
    let poses = poses(set, |p| p.rotation.is_some());
    let stated: Option<Vec<Rotation3<f64>>> = poses.iter().map(|p| p.rotation).collect();
    let (stated, placed) = (stated?, Placed::nominal(robot, set, &poses));
    let own_rad = placed.most_rad(&poses, &stated)?;
    let std_rad = set.stated_rotation_std_rad();
    in_another_reading(&placed, &poses, &stated, own_rad, std_rad)
}

fn off_by(own_rad: f64) -> String {
    format!(
        "the rotations do not fit this robot as they were read: a fifth of the poses is off by more than {:.2}°",
        own_rad.to_degrees()
    )
}

/// The reading that fits much better than the rotations as they were `stated`. `own_rad` is the 80th percentile of the angles with the
/// stated reading.
fn in_another_reading(
    placed: &Placed<'_>,
    poses: &[&Point],
    stated: &[Rotation3<f64>],
    own_rad: f64,
    std_rad: f64,
) -> Option<String> {
    if own_rad <= NOISE_RAD.max(STATED_STDS * std_rad) {
        return None;
    }
    let are_angles = poses.iter().all(|p| p.rotation_angles_rad.is_some());
    let inverse = "the inverse rotation (the measuring frame as the target sees it)";
    let name = if are_angles || placed.base.is_some() {
        inverse.to_owned()
    } else {
        // Reading x, y, z, w as w, x, y, z gives the inverse rotation between two fixed quarter turns. An unknown base and an unknown
        // target absorb these turns, so the fit is the same as for inverted rotations.
        format!("{inverse}, or as quaternions in the order x, y, z, w,")
    };
    let mut others = vec![(
        name,
        stated.iter().map(Rotation3::inverse).collect::<Vec<_>>(),
    )];
    if are_angles {
        others.extend(by_conventions(poses));
    } else {
        let last_first = |r: &Rotation3<f64>| {
            let [x, y, z, w]: [f64; 4] = UnitQuaternion::from_rotation_matrix(r).coords.into();
            // The file's four numbers were read as w, x, y, z.
            UnitQuaternion::new_normalize(Quaternion::new(z, w, x, y)).to_rotation_matrix()
        };
        let name = "quaternions in the order x, y, z, w".to_owned();
        others.push((name, stated.iter().map(last_first).collect()));
    }
    let best = best(placed, poses, others)?;
    (MIN_IMPROVEMENT * best.most_rad <= own_rad).then(|| {
        format!(
            "{}. Read as {} four of five fit to {:.2}°: say so, or write them as stated",
            off_by(own_rad),
            best.name,
            best.most_rad.to_degrees()
        )
    })
}

/// Fit of the inverted poses, if their positions determine the robot's base; 80th percentile, rad.
fn fit_of_inverse_poses(robot: &Robot, set: &MeasurementSet) -> Option<f64> {
    let inverse = MeasurementSet {
        frame: Frame::Instrument,
        ..set.clone().with_inverse_poses()
    };
    let poses = poses(&inverse, |p| p.rotation.is_some());
    let placed = Placed::nominal(robot, &inverse, &poses);
    let rotations: Option<Vec<Rotation3<f64>>> = poses.iter().map(|p| p.rotation).collect();
    let fits = matches!(align(robot, &inverse), Alignment::Fits);
    (placed.base.is_some() && fits)
        .then(|| placed.most_rad(&poses, &rotations?))
        .flatten()
}

/// The convention with which the angles of a set fit the robot best; `None` if there are too few poses.
pub fn best_convention(robot: &Robot, set: &MeasurementSet) -> Option<Reading> {
    let poses = poses(set, |p| p.rotation_angles_rad.is_some());
    let placed = Placed::nominal(robot, set, &poses);
    best(&placed, &poses, by_conventions(&poses))
}

/// The robot, placed by the positions.
struct Placed<'a> {
    robot: &'a Robot,
    links: Vec<Link>,
    /// Rotation of the base in the measuring frame; `None` if the positions do not determine it.
    base: Option<Rotation3<f64>>,
    /// Sign of the controller's value of the last joint.
    last_sign: f64,
}

impl<'a> Placed<'a> {
    fn nominal(robot: &'a Robot, set: &MeasurementSet, poses: &[&Point]) -> Self {
        Self::with_links(robot, robot.links.clone(), set, poses)
    }

    fn with_fitted_zeros(robot: &'a Robot, set: &MeasurementSet, poses: &[&Point]) -> Option<Self> {
        let links = links_with_fitted_zeros(robot, &of_station(set, poses), set.frame)?;
        Some(Self::with_links(robot, links, set, poses))
    }

    fn with_links(
        robot: &'a Robot,
        links: Vec<Link>,
        set: &MeasurementSet,
        poses: &[&Point],
    ) -> Self {
        let base = base_rotation(robot, &links, &of_station(set, poses), set.frame);
        Self {
            robot,
            links,
            base,
            last_sign: 1.0,
        }
    }

    /// The robot with the last joint reversed. If the target is on the last axis, only rotations show this, and the positions give the same
    /// base.
    fn with_last_joint_reversed(robot: &'a Robot, set: &MeasurementSet, poses: &[&Point]) -> Self {
        Self {
            last_sign: -1.0,
            ..Self::nominal(robot, set, poses)
        }
    }

    /// 80th percentile of the angles after rotating the target, and the base if it is unknown, for the best fit; rad.
    fn most_rad(&self, poses: &[&Point], rotations: &[Rotation3<f64>]) -> Option<f64> {
        let fewest = match self.base {
            Some(_) => MIN_POSES,
            None => MIN_WITHOUT_BASE,
        };
        if poses.len() < fewest || poses.len() != rotations.len() {
            return None;
        }
        let flange = |p: &&Point| {
            let mut q_rad = p.q_rad.clone();
            if let Some(last) = q_rad.last_mut() {
                *last *= self.last_sign;
            }
            t_base_flange(&self.links, &self.robot.q_model_rad(&q_rad)).rotation
        };
        let pairs: Vec<_> = poses
            .iter()
            .map(flange)
            .zip(rotations.iter().copied())
            .collect();
        let placed = match self.base {
            Some(base) => robustly(&pairs, |some| Some((base, target_rotation(&base, some)?)))?,
            None => base_and_target_rotation(&pairs)?,
        };
        let mut angles: Vec<f64> = pairs.iter().map(|pair| angle_rad(&placed, pair)).collect();
        angles.sort_by(f64::total_cmp);
        angles.get((4 * angles.len()).div_ceil(5) - 1).copied()
    }
}

/// The points of the poses' station.
fn of_station(set: &MeasurementSet, poses: &[&Point]) -> Vec<Point> {
    let station = poses.first().and_then(|p| p.station.as_deref());
    let points = set.points.iter();
    points
        .filter(|p| p.station.as_deref() == station)
        .cloned()
        .collect()
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
    placed: &Placed<'_>,
    poses: &[&Point],
    readings: Vec<(String, Vec<Rotation3<f64>>)>,
) -> Option<Reading> {
    let reading = |(name, rotations): (String, Vec<Rotation3<f64>>)| {
        let most_rad = placed.most_rad(poses, &rotations)?;
        Some(Reading { name, most_rad })
    };
    let fits = readings.into_iter().filter_map(reading);
    fits.min_by(|a, b| a.most_rad.total_cmp(&b.most_rad))
}
