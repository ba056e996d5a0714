//! Poses whose rotation does not belong to the others, such as a target that an instrument saw turned by half a turn.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::Observed;
use crate::identification::least_squares::hand_eye::{
    angle_rad, base_and_target_rotation, robustly,
};
use crate::kinematics::{Link, t_base_flange};
use std::collections::BTreeMap;

/// Minimum number of poses of a target from one set-up.
const FEWEST_POSES: usize = 8;
/// A turned pose is off by more than this, rad (2°), and by more than [`TIMES_MEDIAN`] times the median.
const LEAST_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const TIMES_MEDIAN: f64 = 10.0;

/// A pose that is turned against the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnedPose {
    /// Its point.
    pub point: usize,
    /// Angle to the rotation that the others predict, rad.
    pub angle_rad: f64,
}

/// The turned poses, by point. Base and target are rotated for the best fit of these links, for each target and set-up.
pub fn turned_poses(
    links: &[Link],
    observed: &Observed,
    arrangement: &Arrangement,
) -> Vec<TurnedPose> {
    let mut groups: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    for (point, rotation) in observed.rotations.iter().enumerate() {
        if rotation.is_some() {
            let key = (observed.targets[point], arrangement.setups[point]);
            groups.entry(key).or_default().push(point);
        }
    }
    let mut turned: Vec<TurnedPose> = groups
        .into_values()
        .filter(|points| points.len() >= FEWEST_POSES)
        .flat_map(|points| turned_of(links, observed, &points))
        .collect();
    turned.sort_by_key(|pose| pose.point);
    turned
}

fn turned_of(links: &[Link], observed: &Observed, points: &[usize]) -> Vec<TurnedPose> {
    let pair = |point: &usize| {
        let flange = t_base_flange(links, &observed.all[*point].q_rad);
        Some((flange.rotation, observed.rotations[*point]?))
    };
    let pairs: Vec<_> = points.iter().filter_map(pair).collect();
    let Some(placed) = robustly(&pairs, base_and_target_rotation) else {
        return vec![];
    };
    let angles_rad: Vec<f64> = pairs.iter().map(|pair| angle_rad(&placed, pair)).collect();
    let mut sorted = angles_rad.clone();
    sorted.sort_by(f64::total_cmp);
    let median_rad = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let limit_rad = LEAST_RAD.max(TIMES_MEDIAN * median_rad);
    let turned = |(point, angle_rad): (&usize, &f64)| {
        (*angle_rad > limit_rad).then_some(TurnedPose {
            point: *point,
            angle_rad: *angle_rad,
        })
    };
    points.iter().zip(&angles_rad).filter_map(turned).collect()
}
