//! Steps in the rotations of a target along the measuring order: a target of poses that was twisted on its holder. Its position may not
//! show this.
//!
//! Let e_k = log(R_predictedᵀ·R_measured) be the rotation vector of pose k in the frame of its target. All poses after a twist gain the
//! same δ. Of all places with n₁ poses before and n₂ after, the one with the largest gain g = n₁·n₂/(n₁ + n₂)·|ē₂ − ē₁|² is taken; this is
//! the likelihood ratio of a change of a mean. The tests are those for positions ([`steps`](crate::identification::screening::steps)): F =
//! (g/3)/(rest/freedom) exceeds what noise gives at any place, g exceeds the gains in random orders of the configurations, and the smaller
//! side has rotated by twice the scatter of all poses. If a steady rotation explains more than the step, no step is reported. Errors of the
//! wrist's joints look like steps along a path through the workspace. Random orders break the path, so a twist that is not larger than such
//! errors is not reported.

use crate::identification::least_squares::hand_eye::{
    base_and_target_rotation, robustly, target_rotation,
};
use crate::identification::screening::row_order::{
    by_configuration, design_effect, holds_in_random_orders,
};
use crate::identification::statistics::distributions::f_tail;
use crate::kinematics::rotation::rotation_log;
use crate::solvers::median::median;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};

/// Probability of reporting a twist if there is none, over all places.
const FALSE_ALARMS: f64 = 0.002;
/// Minimum ratio of two mean squares: the rotation of the poses on the smaller side, and the remaining rotations.
const SMALLEST_EFFECT: f64 = 4.0;
/// Smallest twist that is reported, rad (0.3°): six times the usual error of a robot's angle.
const SMALLEST_TURN_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Minimum number of poses on either side.
const MIN_POSES: usize = 3;
/// Rotation vectors are shortened to this multiple of their median length, so that a few turned poses do not look like a step.
const MAX_TO_MEDIAN: f64 = 3.0;
/// Number of fitted parameters: base and target, and the step.
const N_FITTED_PARAMETERS: f64 = 6.0;
const N_STEP_PARAMETERS: f64 = 3.0;

/// The most significant twist of one target from one set-up: the index of the first pair after it, and the rotation vector in the frame of
/// the target, rad. Each pair has the flange in the base frame and its target in the measuring frame; the pairs are in measuring order.
/// `configurations` has the configuration of each. `None` if there is no twist, or if the watch stops.
pub fn target_turn(
    pairs: &[(Rotation3<f64>, Rotation3<f64>)],
    configurations: &[usize],
    watch: &Watch<'_>,
) -> Option<(usize, Vector3<f64>)> {
    let (base, target) = robustly(pairs, base_and_target_rotation)?;
    let mut vectors: Vec<Vector3<f64>> = pairs
        .iter()
        .map(|(flange, measured)| rotation_log(&((base * flange * target).inverse() * measured)))
        .collect();
    let longest = MAX_TO_MEDIAN * median(vectors.iter().map(Vector3::norm))?;
    for vector in &mut vectors {
        *vector = vector.cap_magnitude(longest);
    }
    let mean = vectors.iter().sum::<Vector3<f64>>() / vectors.len() as f64;
    vectors.iter_mut().for_each(|vector| *vector -= mean);

    let n = vectors.len() as f64;
    let in_order: Vec<usize> = (0..vectors.len()).collect();
    let (first, gain) = largest_gain(&vectors, &in_order)?;
    let rest = vectors.iter().map(Vector3::norm_squared).sum::<f64>() - gain;
    let freedom = 3.0 * n - N_FITTED_PARAMETERS - N_STEP_PARAMETERS;
    let n_minor = first.min(vectors.len() - first) as f64;
    if freedom <= 0.0
        || gain <= gain_of_steady_turn(&vectors)
        || gain / n_minor < SMALLEST_EFFECT * rest / n
    {
        return None;
    }
    let flat = DVector::from_iterator(
        3 * vectors.len(),
        vectors.iter().flat_map(|v| v.iter().copied()),
    );
    let not_fitted = DMatrix::zeros(flat.len(), 0);
    let variance =
        rest / freedom * design_effect(&flat, &not_fitted, configurations.iter().copied());
    if f_tail(
        gain / N_STEP_PARAMETERS / variance,
        N_STEP_PARAMETERS,
        freedom,
    ) * n
        > FALSE_ALARMS
    {
        return None;
    }
    let is_smaller =
        |order: &[usize]| largest_gain(&vectors, order).is_none_or(|(_, other)| other < gain);
    if !holds_in_random_orders(by_configuration(configurations), watch, is_smaller) {
        return None;
    }
    let turn_rad = turn_rad(pairs, first)?;
    (turn_rad.norm() >= SMALLEST_TURN_RAD).then_some((first, turn_rad))
}

/// The change of the mean that explains most: the first place after it, and its gain.
fn largest_gain(vectors: &[Vector3<f64>], order: &[usize]) -> Option<(usize, f64)> {
    let n = order.len();
    let all: Vector3<f64> = vectors.iter().sum();
    let mut before = Vector3::zeros();
    let gains = order.iter().enumerate().map(|(k, place)| {
        let (n_before, n_after) = (k as f64, (n - k) as f64);
        let change = (all - before) / n_after - before / n_before.max(1.0);
        before += vectors[*place];
        (k, n_before * n_after / n as f64 * change.norm_squared())
    });
    gains
        .filter(|(k, _)| (MIN_POSES..=n - MIN_POSES.min(n)).contains(k))
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Gain of a rotation that grows steadily from the first pose to the last.
fn gain_of_steady_turn(vectors: &[Vector3<f64>]) -> f64 {
    let middle = (vectors.len() as f64 - 1.0) / 2.0;
    let time = |k: usize| k as f64 - middle;
    let along: Vector3<f64> = vectors
        .iter()
        .enumerate()
        .map(|(k, vector)| vector * time(k))
        .sum();
    let squares: f64 = (0..vectors.len()).map(|k| time(k) * time(k)).sum();
    along.norm_squared() / squares
}

/// The rotation between the poses before and after a place. The base is fitted to the side with more poses, the target to each side.
fn turn_rad(pairs: &[(Rotation3<f64>, Rotation3<f64>)], first: usize) -> Option<Vector3<f64>> {
    let (before, after) = pairs.split_at(first);
    let larger = if before.len() < after.len() {
        after
    } else {
        before
    };
    let (base, _) = robustly(larger, base_and_target_rotation)?;
    let target = |side: &[(Rotation3<f64>, Rotation3<f64>)]| {
        robustly(side, |pairs| Some((base, target_rotation(&base, pairs)?)))
    };
    let ((_, target_before), (_, target_after)) = (target(before)?, target(after)?);
    Some(rotation_log(&(target_before.inverse() * target_after)))
}
