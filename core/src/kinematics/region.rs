//! The region of joint space in which a robot was measured. Corrections that were identified there are not reliable far from it.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// A joint value counts as measured if it is outside the measured range by at most this share of the range. The outermost of twenty random
/// poses leave a twentieth of the range free at either end, and the physical effects are the same just beyond the last pose.
const MARGIN: f64 = 0.2;
/// Minimum of this margin, rad (2°).
const MIN_MARGIN_RAD: f64 = 0.035;
/// Combinations of joint values count as measured if their squared (Mahalanobis) distance is at most this multiple of the largest one of a
/// measured pose from the others. Random poses of the same kind stay below it.
const DISTANCE_MARGIN: f64 = 1.5;
/// Upper limit of the leverage. A pose that the others do not determine has leverage 1, and near 1 its distance from the others cannot be
/// computed.
const HIGHEST_LEVERAGE: f64 = 0.8;

/// The joint values at which a robot was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredRegion {
    /// Smallest value of each joint, rad.
    pub lowest_rad: Vec<f64>,
    /// Largest value of each joint, rad.
    pub highest_rad: Vec<f64>,
    /// Mean of each joint, rad.
    pub mean_rad: Vec<f64>,
    /// Lower triangle L, row by row, of the Cholesky factor L·Lᵀ of the joints' covariance, rad.
    pub spread_rad: Vec<f64>,
    /// Largest squared distance |L⁻¹·(q − mean)|² of a measured pose, each computed from the other poses.
    pub farthest: f64,
}

impl MeasuredRegion {
    /// The region of some poses (rows of joint values, rad), at least one.
    pub fn of<'a>(poses: impl Iterator<Item = &'a [f64]> + Clone, n_joints: usize) -> Self {
        let n = poses.clone().count().max(1) as f64;
        let (mut lowest_rad, mut highest_rad, mut mean_rad) = (
            vec![f64::MAX; n_joints],
            vec![f64::MIN; n_joints],
            vec![0.0; n_joints],
        );
        for q in poses.clone() {
            for j in 0..n_joints {
                lowest_rad[j] = lowest_rad[j].min(q[j]);
                highest_rad[j] = highest_rad[j].max(q[j]);
                mean_rad[j] += q[j] / n;
            }
        }
        // A joint that hardly moves is limited by its range. In the covariance it counts as if it had moved by the margin.
        let mut covariance =
            DMatrix::from_diagonal_element(n_joints, n_joints, MIN_MARGIN_RAD * MIN_MARGIN_RAD);
        for q in poses.clone() {
            let off = DVector::from_fn(n_joints, |j, _| q[j] - mean_rad[j]);
            covariance.ger(1.0 / n, &off, &off, 1.0);
        }
        let factor = covariance.cholesky().map_or_else(
            || DMatrix::identity(n_joints, n_joints),
            |cholesky| cholesky.l(),
        );
        let spread_rad = (0..n_joints)
            .flat_map(|row| (0..=row).map(move |column| (row, column)))
            .map(|at| factor[at])
            .collect();
        let mut region = Self {
            lowest_rad,
            highest_rad,
            mean_rad,
            spread_rad,
            farthest: 0.0,
        };
        // d² of a pose from the mean and covariance of the other poses is about d²/(1 − leverage)²
        let from_others = |distance: f64| {
            let left = 1.0 - ((1.0 + distance) / n).min(HIGHEST_LEVERAGE);
            distance / (left * left)
        };
        region.farthest = poses
            .map(|q| from_others(region.distance(q)))
            .fold(0.0, f64::max);
        region
    }

    /// Weight of the corrections at a pose: 1 inside the region, 0 far from it, and smooth in between. Whole turns of a joint make no difference.
    pub fn weight(&self, q_rad: &[f64]) -> f64 {
        let turned: Vec<f64> = (0..q_rad.len())
            .map(|j| self.nearest_turn(j, q_rad[j]))
            .collect();
        let beyond = |j: usize| {
            let margin = self.margin_rad(j);
            let outside = (self.lowest_rad[j] - turned[j]).max(turned[j] - self.highest_rad[j]);
            (outside - margin) / margin
        };
        let joints = (0..turned.len()).map(beyond).fold(f64::MIN, f64::max);
        let together = if self.farthest > 0.0 {
            self.distance(&turned) / (DISTANCE_MARGIN * self.farthest) - 1.0
        } else {
            0.0
        };
        let t = joints.max(together).clamp(0.0, 1.0);
        1.0 - t * t * (3.0 - 2.0 * t)
    }

    /// True if the weight of the corrections is below 1.
    pub fn is_extrapolated(&self, q_rad: &[f64]) -> bool {
        self.weight(q_rad) < 1.0
    }

    fn margin_rad(&self, joint: usize) -> f64 {
        (MARGIN * (self.highest_rad[joint] - self.lowest_rad[joint])).max(MIN_MARGIN_RAD)
    }

    /// The joint value, shifted by whole turns to be nearest to the middle of the measured range.
    fn nearest_turn(&self, joint: usize, q_rad: f64) -> f64 {
        let middle = 0.5 * (self.lowest_rad[joint] + self.highest_rad[joint]);
        q_rad - TAU * ((q_rad - middle) / TAU).round()
    }

    /// |L⁻¹·(q − mean)|², by forward substitution.
    fn distance(&self, q_rad: &[f64]) -> f64 {
        let n = q_rad.len();
        let (mut z, mut at, mut sum) = (vec![0.0; n], 0, 0.0);
        for row in 0..n {
            let known: f64 = (0..row)
                .map(|column| self.spread_rad[at + column] * z[column])
                .sum();
            z[row] = (q_rad[row] - self.mean_rad[row] - known) / self.spread_rad[at + row];
            at += row + 1;
            sum += z[row] * z[row];
        }
        sum
    }
}
