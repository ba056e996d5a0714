//! Request of a plan.

use crate::identification::model::objective::{Observation, posed_targets};
use crate::identification::model::parameters::{
    Parameter, complete_parameters, paper_parameters, target_rotation_parameters,
};
use crate::identification::{KinematicModel, Model};
use crate::kinematics::Robot;
use crate::planning::room::Room;
use nalgebra::{Rotation3, Vector3};

/// Request of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRequest<'a> {
    /// The robot with its nominal links and joint limits.
    pub robot: &'a Robot,
    /// The model that will be identified.
    pub model: Model,
    /// Position of the target in the flange frame, mm.
    pub target_mm: Vector3<f64>,
    /// The set-ups of the instrument, in the order in which they are measured. The target stays on the flange, the base differs.
    pub set_ups: Vec<SetUp>,
    /// Number of random configurations to choose from, for each set-up.
    pub n_candidates: usize,
    /// True if poses of the target are planned, false for positions.
    pub is_of_poses: bool,
    /// Noise of the planned and of the earlier measurements.
    pub noise: Noise,
    /// Seed of the candidates.
    pub seed: u64,
    /// Earlier measurements: the points of each session and station.
    pub measured: Vec<Vec<Observation>>,
}

/// One set-up of the instrument.
#[derive(Clone, Debug, PartialEq)]
pub struct SetUp {
    /// Number of configurations, including repeats.
    pub n_configurations: usize,
    /// Number of the first configurations that are measured again at the end.
    pub n_repeats: usize,
    /// The region in which the robot may move.
    pub room: Room,
}

impl SetUp {
    /// Number of configurations that are repeated: `n_repeats`, but at most half of all.
    pub fn n_repeated(&self) -> usize {
        self.n_repeats.min(self.n_configurations / 2)
    }
}

impl Noise {
    /// Length that converts an angle to the scale of positions, mm/rad.
    pub fn mm_per_rad(&self) -> f64 {
        self.position_std_mm / self.rotation_std_rad
    }
}

/// Noise of the measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of a measured coordinate, mm.
    pub position_std_mm: f64,
    /// Standard deviation of a component of a pose's rotation vector, rad.
    pub rotation_std_rad: f64,
}

/// The nominal robot with its base at the measuring frame and the given targets, which have the flange's rotation.
pub fn nominal(robot: &Robot, targets_mm: Vec<Vector3<f64>>) -> KinematicModel {
    KinematicModel {
        target_rotations: vec![Rotation3::identity(); targets_mm.len()],
        targets_mm,
        ..KinematicModel::nominal(&robot.links, 0)
    }
}

/// The free parameters of a model with `n_targets` targets, and the rotations of those whose poses are measured.
pub fn parameters(
    robot: &Robot,
    model: Model,
    n_targets: usize,
    measured: &[Observation],
) -> Vec<Parameter> {
    let mut parameters = match model {
        Model::Paper => paper_parameters(robot.links.len()),
        Model::Complete => complete_parameters(robot.links.len(), n_targets),
    };
    parameters.extend(target_rotation_parameters(&posed_targets(measured)));
    parameters
}
