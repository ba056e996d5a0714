//! Joint zeros that a session hardly shows, because base and targets are placed on its own points.
//!
//! Let J be the displacement of the points by a joint's zero, and P that by base and targets. The placement takes up the part of J in the span of P;
//! J − P·P⁺·J is left. A session shows a zero as well as the whole workspace does if this part, as an rms over the points, is as large as over random
//! configurations within the joint limits. If joint 6 stands still, an error of joint 5 is a shift of the reflector, and nothing is left.

use crate::identification::KinematicModel;
use crate::identification::objective::{Observation, weighted_jacobian};
use crate::identification::parameters::{Parameter, Quantity, placement_parameters};
use crate::identification::quick_check::span;
use crate::identification::workspace::random_configurations;
use crate::kinematics::Robot;
use nalgebra::{DMatrix, Vector3};

/// A zero is hidden if the session shows less than this share of what it does over the workspace: the tool is then off by more than five times what
/// the session shows.
const SHOWN: f64 = 0.2;
/// The placement takes up a zero everywhere if less than this share of it is left over the workspace: that of the first and last joint.
const LEFT: f64 = 1e-3;
/// Number of configurations of the workspace.
const N_CONFIGURATIONS: usize = 100;
/// Seed of the configurations.
const SEED: u64 = 1;
/// Maximum number of points, evenly from all of them.
const MAX_POINTS: usize = 500;

/// A joint whose zero a session hardly shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenZero {
    /// Joint, 0-based.
    pub joint: usize,
    /// Share of the zero's effect that the session shows, 0 to 1.
    pub share: f64,
}

/// The hidden zeros of a session on which `placed` was placed. `observations` are its points.
pub fn hidden_zeros(
    robot: &Robot,
    placed: &KinematicModel,
    observations: &[Observation],
) -> Vec<HiddenZero> {
    let step = observations.len().div_ceil(MAX_POINTS).max(1);
    let session: Vec<Observation> = observations.iter().step_by(step).map(plain).collect();
    let Some(first) = session.first() else {
        return vec![];
    };
    let n_targets = placed.targets_mm.len();
    let workspace: Vec<Observation> = random_configurations(robot, N_CONFIGURATIONS, SEED)
        .iter()
        .flat_map(|q_rad| {
            let q_rad = robot.q_model_rad(q_rad);
            (0..n_targets).map(move |target| Observation {
                q_rad: q_rad.clone(),
                target,
                ..first.clone()
            })
        })
        .collect();
    let (Some(shown), Some(everywhere)) = (left(placed, &session), left(placed, &workspace)) else {
        return vec![];
    };
    let joints = 0..placed.links.len();
    joints
        .filter_map(|joint| {
            let (left_mm, whole_mm) = everywhere[joint];
            let share = shown[joint].0 / left_mm;
            let is_hidden = left_mm > LEFT * whole_mm && share < SHOWN;
            is_hidden.then_some(HiddenZero { joint, share })
        })
        .collect()
}

/// Unweighted, without a rotation.
fn plain(observation: &Observation) -> Observation {
    Observation {
        weight: 1.0,
        whitening: None,
        ..observation.position_alone()
    }
}

/// For each joint: what is left of its zero's effect on the points after the placement, and the whole effect, rms, mm per rad.
fn left(model: &KinematicModel, observations: &[Observation]) -> Option<Vec<(f64, f64)>> {
    let jacobian = |parameters: &[Parameter]| {
        weighted_jacobian(model, parameters, observations, &Vector3::zeros())
    };
    let zeros: Vec<Parameter> = (0..model.links.len())
        .map(|link| Parameter::Link(link, Quantity::ThetaOffset))
        .collect();
    let whole = jacobian(&zeros);
    let taken = span(&jacobian(&placement_parameters(model.targets_mm.len()))).ok()?;
    let left: DMatrix<f64> = &whole - &taken * taken.tr_mul(&whole);
    let rms = |column: f64| column / (observations.len() as f64).sqrt();
    let columns = left.column_iter().zip(whole.column_iter());
    Some(
        columns
            .map(|(left, whole)| (rms(left.norm()), rms(whole.norm())))
            .collect(),
    )
}
