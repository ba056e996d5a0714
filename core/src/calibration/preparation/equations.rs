//! Counts the equations that points give, and the parameter combinations of a model.

use crate::identification::KinematicModel;
use crate::identification::least_squares::linearisation::scaled_jacobian_at;
use crate::identification::least_squares::problem::usual_mm_per_rad;
use crate::identification::model::identifiability::{decompose, prior_scales};
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::Parameter;
use crate::identification::model::pose_rows::MeasuredRotation;
use crate::kinematics::{Robot, reach_mm};
use crate::measurement::set::Configurations;
use nalgebra::{DMatrix, Rotation3, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::collections::{BTreeMap, BTreeSet};

/// Random poses in addition to one per parameter. They give more than three times as many equations as there are combinations.
const MORE_POSES: usize = 10;

/// Singular values below this share of the largest count as zero.
const ZERO: f64 = 1e-9;

/// Positions of three or more points on a rigid flange determine six numbers, however many points there are.
const EQUATIONS_PER_CONFIGURATION: usize = 6;

/// Measured part of a target.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Position,
    Rotation,
}

/// Number of equations from distinct configurations: three per target position and three per target rotation, at most six per configuration. Counting
/// stops at `enough`.
pub fn n_equations(observations: &[Observation], enough: usize) -> usize {
    let mut configurations = Configurations::default();
    let mut targets_at: BTreeMap<usize, BTreeSet<(usize, Part)>> = BTreeMap::new();
    let mut found = 0;
    for (row, o) in observations.iter().enumerate() {
        if found >= enough {
            break;
        }
        let targets = targets_at
            .entry(configurations.first_row_like(&o.q_rad, row))
            .or_default();
        let of = |n_targets: usize| (3 * n_targets).min(EQUATIONS_PER_CONFIGURATION);
        let before = of(targets.len());
        targets.insert((o.target, Part::Position));
        if o.rotation.is_some() {
            targets.insert((o.target, Part::Rotation));
        }
        found += of(targets.len()) - before;
    }
    found
}

/// Rank of the model: the number of combinations that generic poses determine, whatever the measured poses are.
pub fn model_rank(robot: &Robot, parameters: &[Parameter], n_targets: usize) -> usize {
    let scale = prior_scales(parameters, reach_mm(&robot.links));
    let n_poses = (parameters.len() + MORE_POSES).max(n_targets);
    decompose(
        generic_jacobian(robot, parameters, n_targets, n_poses),
        &scale,
        0.0,
    )
    .rank_relative(ZERO)
}

/// Scaled Jacobian at `n_poses` random poses, with the targets taken in turn.
pub fn generic_jacobian(
    robot: &Robot,
    parameters: &[Parameter],
    n_targets: usize,
    n_poses: usize,
) -> DMatrix<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut angle = || random.random_range(-std::f64::consts::PI..std::f64::consts::PI);
    let mut observations: Vec<Observation> = (0..n_poses)
        .map(|i| {
            let q_rad = (0..robot.links.len()).map(|_| angle()).collect();
            Observation::at(q_rad, Vector3::zeros(), i % n_targets.max(1))
        })
        .collect();
    let mut model = KinematicModel::nominal(&robot.links, n_targets.max(1));
    let reach_mm = reach_mm(&robot.links);
    if parameters
        .iter()
        .any(|p| matches!(p, Parameter::Target(..)))
    {
        // Places the targets off every axis of the robot, so that they are generic.
        for (i, target) in model.targets_mm.iter_mut().enumerate() {
            *target = Vector3::new(0.036 + 0.01 * i as f64, -0.025, 0.057) * reach_mm;
        }
    }
    // Adds rotations if target rotations are parameters, because positions do not determine them.
    if parameters
        .iter()
        .any(|p| matches!(p, Parameter::TargetRotation(..)))
    {
        let mm_per_rad = usual_mm_per_rad(reach_mm);
        model.target_rotations = vec![Rotation3::identity(); model.targets_mm.len()];
        for o in &mut observations {
            let predicted = model.rotation(&o.q_rad, o.target);
            o.rotation = predicted.map(|rotation| MeasuredRotation {
                rotation,
                mm_per_rad,
                lever_mm: Vector3::zeros(),
            });
        }
    }
    let scale = prior_scales(parameters, reach_mm);
    scaled_jacobian_at(&model, parameters, &scale, &observations)
}
