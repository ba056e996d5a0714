//! What is to be planned.

use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, complete_parameters, paper_parameters};
use crate::identification::{KinematicModel, Model};
use crate::kinematics::Robot;
use crate::planning::room::Room;
use nalgebra::Vector3;

/// What is to be planned.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRequest<'a> {
    /// The robot with its nominal links and joint limits.
    pub robot: &'a Robot,
    /// The model that will be identified.
    pub model: Model,
    /// Where the reflector will be, in the flange frame, mm.
    pub target_mm: Vector3<f64>,
    /// Configurations in the plan, repeats included.
    pub n_configurations: usize,
    /// Of them, how many of the first are measured again at the end.
    pub n_repeats: usize,
    /// Random configurations to choose from.
    pub n_candidates: usize,
    /// Standard deviation of a measured coordinate, mm.
    pub noise_std_mm: f64,
    /// Seed of the candidates.
    pub seed: u64,
    /// Where the robot may go.
    pub room: Room,
    /// What was measured already: each session's points.
    pub measured: Vec<Vec<Observation>>,
}

/// The nominal robot at its base, with one target.
pub fn nominal(robot: &Robot, targets_mm: Vec<Vector3<f64>>) -> KinematicModel {
    KinematicModel {
        targets_mm,
        ..KinematicModel::nominal(&robot.links, 0)
    }
}

/// The free parameters of a model with some targets.
pub fn parameters(robot: &Robot, model: Model, n_targets: usize) -> Vec<Parameter> {
    match model {
        Model::Paper => paper_parameters(robot.links.len()),
        Model::Complete => complete_parameters(robot.links.len(), n_targets),
    }
}
