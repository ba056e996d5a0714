//! Request of a plan.

use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, complete_parameters, paper_parameters};
use crate::identification::{KinematicModel, Model};
use crate::kinematics::Robot;
use crate::planning::room::Room;
use nalgebra::Vector3;

/// Request of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRequest<'a> {
    /// The robot with its nominal links and joint limits.
    pub robot: &'a Robot,
    /// The model that will be identified.
    pub model: Model,
    /// Position of the reflector in the flange frame, mm.
    pub target_mm: Vector3<f64>,
    /// Number of configurations in the plan, including repeats.
    pub n_configurations: usize,
    /// Number of the first configurations that are measured again at the end.
    pub n_repeats: usize,
    /// Number of random configurations to choose from.
    pub n_candidates: usize,
    /// Standard deviation of a measured coordinate, mm.
    pub noise_std_mm: f64,
    /// Seed of the candidates.
    pub seed: u64,
    /// The region in which the robot may move.
    pub room: Room,
    /// Earlier measurements: the points of each session.
    pub measured: Vec<Vec<Observation>>,
}

/// The nominal robot with its base at the measuring frame and the given targets.
pub fn nominal(robot: &Robot, targets_mm: Vec<Vector3<f64>>) -> KinematicModel {
    KinematicModel {
        targets_mm,
        ..KinematicModel::nominal(&robot.links, 0)
    }
}

/// The free parameters of a model with `n_targets` targets.
pub fn parameters(robot: &Robot, model: Model, n_targets: usize) -> Vec<Parameter> {
    match model {
        Model::Paper => paper_parameters(robot.links.len()),
        Model::Complete => complete_parameters(robot.links.len(), n_targets),
    }
}
