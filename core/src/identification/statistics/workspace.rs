//! Uncertainty of a calibrated robot over its workspace.

use crate::identification::model::objective::Observation;
use crate::kinematics::Robot;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::f64::consts::{FRAC_PI_2, PI};

/// Number of random configurations that represent the workspace: their mean is known to about 2 %.
const N_CONFIGURATIONS: usize = 256;
/// Seed of these configurations. It is the same for every robot and job, so that results can be compared.
const SEED: u64 = 0;

/// Predicted uncertainty of the tool's position over the workspace, one standard deviation, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolUncertainty {
    /// Mean over configurations.
    pub mean_mm: f64,
    /// Largest value.
    pub max_mm: f64,
}

/// The tool's uncertainty at random configurations of the workspace. `std_mm` returns the standard deviation of a target's position, mm;
/// the target with the largest one counts. The range of a joint is given by its limits, if they are known. Otherwise it is the measured
/// range, extended to at least a quarter turn to both sides of its middle.
pub fn tool_uncertainty(
    robot: &Robot,
    observations: &[Observation],
    n_targets: usize,
    std_mm: impl Fn(&[f64], usize) -> f64,
) -> ToolUncertainty {
    let ranges: Vec<(f64, f64)> = (0..robot.links.len())
        .map(|joint| range(robot, observations, joint))
        .collect();
    let (mut sum, mut max_mm) = (0.0, 0.0f64);
    for q_rad in random_in(&ranges, N_CONFIGURATIONS, SEED) {
        let of_targets = (0..n_targets).map(|target| std_mm(&q_rad, target));
        let largest_mm = of_targets.fold(0.0, f64::max);
        sum += largest_mm;
        max_mm = max_mm.max(largest_mm);
    }
    ToolUncertainty {
        mean_mm: sum / N_CONFIGURATIONS as f64,
        max_mm,
    }
}

/// Random configurations within the joint limits, rad, in the controller's convention. Without a limit, the range is a quarter turn to both sides of
/// 0. A range is at most one turn.
pub fn random_configurations(robot: &Robot, n: usize, seed: u64) -> Vec<Vec<f64>> {
    let ranges: Vec<(f64, f64)> = robot
        .joint_limits_rad
        .iter()
        .map(|limits| limits.map_or((-FRAC_PI_2, FRAC_PI_2), within_a_turn))
        .collect();
    random_in(&ranges, n, seed)
}

/// Random configurations in ranges of the joints, rad.
pub fn random_in(ranges: &[(f64, f64)], n: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut value = |(low, high): &(f64, f64)| low + (high - low) * random.random::<f64>();
    (0..n)
        .map(|_| ranges.iter().map(&mut value).collect())
        .collect()
}

/// Limits, cut to half a turn to both sides of 0, or of their middle if 0 is outside.
pub fn within_a_turn((low, high): (f64, f64)) -> (f64, f64) {
    let middle = if low <= 0.0 && high >= 0.0 {
        0.0
    } else {
        0.5 * (low + high)
    };
    (low.max(middle - PI), high.min(middle + PI))
}

/// Range of a joint, rad, in the model's convention. Limits are in the controller's convention, so they are not used with a joint map.
fn range(robot: &Robot, observations: &[Observation], joint: usize) -> (f64, f64) {
    let limits = robot
        .joint_limits_rad
        .get(joint)
        .copied()
        .flatten()
        .filter(|_| robot.joint_map.is_none());
    if let Some(limits) = limits {
        return within_a_turn(limits);
    }
    let values = observations.iter().map(|o| o.q_rad[joint]);
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), q| {
        (low.min(q), high.max(q))
    });
    let middle = 0.5 * (low + high);
    (low.min(middle - FRAC_PI_2), high.max(middle + FRAC_PI_2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_stays_inside_limits_beyond_half_a_turn() {
        let mut robot = Robot::from_links(vec![]);
        robot.joint_limits_rad = vec![Some((3.5, 6.6)), Some((-9.0, 9.0))];
        assert_eq!(range(&robot, &[], 0), (3.5, 6.6));
        assert_eq!(range(&robot, &[], 1), (-PI, PI));
    }
}
