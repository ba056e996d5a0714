//! Finds rotations of poses that contradict the others: single poses, e.g. a target that the instrument saw rotated by half a turn, and a
//! target that was twisted on its holder.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::Observed;
use crate::identification::least_squares::hand_eye::{
    angle_rad, base_and_target_rotation, robustly,
};
use crate::identification::screening::steps::{Moved, Step};
use crate::identification::screening::target_turns::target_turn;
use crate::kinematics::{Link, t_base_flange};
use crate::solvers::median::median;
use crate::solvers::watch::Watch;
use nalgebra::{Rotation3, Vector3};
use std::collections::BTreeMap;

/// Minimum number of poses of a target from one set-up.
const MIN_POSES: usize = 8;
/// A pose is turned if its rotation is off by more than this, rad (2°), and by more than [`MIN_TIMES_MEDIAN`] times the median.
const MIN_TURN_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const MIN_TIMES_MEDIAN: f64 = 10.0;

/// A pose whose rotation contradicts the other poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnedPose {
    /// Its point.
    pub point: usize,
    /// Angle to the rotation that the others predict, rad.
    pub angle_rad: f64,
}

/// The turned poses, by point. For each segment of a target and each set-up, base and target are rotated for the best fit of these links.
pub fn turned_poses(
    links: &[Link],
    observed: &Observed,
    arrangement: &Arrangement,
) -> Vec<TurnedPose> {
    let mut turned: Vec<TurnedPose> = groups(observed, arrangement)
        .flat_map(|points| turned_of(links, observed, &points))
        .collect();
    turned.sort_by_key(|pose| pose.point);
    turned
}

/// The first target, of all segments, that was twisted. Both pairs of links must show the same twist, because positions may not determine
/// the flange of the fitted links.
pub fn turned_target(
    links: [&[Link]; 2],
    observed: &Observed,
    arrangement: &Arrangement,
    watch: &Watch<'_>,
) -> Option<Step> {
    let configurations = observed.all_clusters();
    groups(observed, arrangement).find_map(|points| {
        let of_points: Vec<usize> = points.iter().map(|point| configurations[*point]).collect();
        let by = |links| {
            let pairs = pairs(links, observed, &points);
            watch
                .goes_on()
                .then(|| target_turn(&pairs, &of_points, watch))
                .flatten()
        };
        let [fitted, nominal] = links;
        let ((first, turn_rad), (by_nominal, _)) = by(fitted).zip(by(nominal))?;
        (first.abs_diff(by_nominal) <= 1).then(|| Step {
            moved: Moved::Target(observed.targets[points[first]]),
            first: points[first],
            shift_mm: Vector3::zeros(),
            turn_rad,
            is_one_point: false,
        })
    })
}

/// The poses of each segment of a target and each set-up, in measuring order; only groups with enough poses.
fn groups(observed: &Observed, arrangement: &Arrangement) -> impl Iterator<Item = Vec<usize>> {
    let mut groups: BTreeMap<(usize, usize, usize), Vec<usize>> = BTreeMap::new();
    for point in &arrangement.order {
        if observed.rotations[*point].is_some() {
            let key = (
                observed.targets[*point],
                arrangement.segments[*point],
                arrangement.setups[*point],
            );
            groups.entry(key).or_default().push(*point);
        }
    }
    groups
        .into_values()
        .filter(|points| points.len() >= MIN_POSES)
}

/// Flange in the base frame and target in the measuring frame of each pose.
fn pairs(
    links: &[Link],
    observed: &Observed,
    points: &[usize],
) -> Vec<(Rotation3<f64>, Rotation3<f64>)> {
    let pair = |point: &usize| {
        let flange = t_base_flange(links, &observed.all[*point].q_rad);
        Some((flange.rotation, observed.rotations[*point]?))
    };
    points.iter().filter_map(pair).collect()
}

fn turned_of(links: &[Link], observed: &Observed, points: &[usize]) -> Vec<TurnedPose> {
    let pairs = pairs(links, observed, points);
    let Some(placed) = robustly(&pairs, base_and_target_rotation) else {
        return vec![];
    };
    let angles_rad: Vec<f64> = pairs.iter().map(|pair| angle_rad(&placed, pair)).collect();
    let median_rad = median(angles_rad.iter().copied()).unwrap_or(0.0);
    let limit_rad = MIN_TURN_RAD.max(MIN_TIMES_MEDIAN * median_rad);
    let turned = |(point, angle_rad): (&usize, &f64)| {
        (*angle_rad > limit_rad).then_some(TurnedPose {
            point: *point,
            angle_rad: *angle_rad,
        })
    };
    points.iter().zip(&angles_rad).filter_map(turned).collect()
}
