//! Residuals and their derivatives in a search space, for least squares: prepared once per fit, evaluated without allocating.

use crate::identification::KinematicModel;
use crate::identification::objective::Observation;
use crate::identification::parameters::{apply_into, left_jacobian};
use crate::identification::search_space::SearchSpace;
use crate::identification::swarm::moved;
use crate::kinematics::batch::{Along, InstructionSet, Lanes, Moved, OneRobot, PoseLanes};
use std::borrow::Cow;

/// The residuals of some observations as a function of a space's coordinates. Rows are in the order of [`PoseLanes`], and those of
/// missing poses are zero: sums over all rows are those of `objective.rs`.
pub struct Linearisation<'a> {
    space: Cow<'a, SearchSpace>,
    poses: PoseLanes,
    moved: Vec<Moved>,
    robot: OneRobot,
    model: KinematicModel,
    deviation: Vec<f64>,
    raw: Vec<[Lanes; 3]>,
}

impl<'a> Linearisation<'a> {
    /// Prepares the poses of `observations`.
    pub fn new(space: &'a SearchSpace, observations: &[Observation]) -> Self {
        Self::prepare(Cow::Borrowed(space), observations)
    }

    /// As [`Self::new`], with the space's parameters themselves for coordinates, mm or rad.
    pub fn of_parameters(
        space: &SearchSpace,
        observations: &[Observation],
    ) -> Linearisation<'static> {
        let unscaled = SearchSpace::raw(
            space.reference.clone(),
            space.parameters.clone(),
            vec![1.0; space.parameters.len()],
        );
        Linearisation::prepare(Cow::Owned(unscaled), observations)
    }

    fn prepare(space: Cow<'a, SearchSpace>, observations: &[Observation]) -> Self {
        let mut poses = PoseLanes::new(space.reference.links.len());
        for o in observations {
            poses.push(&o.q_rad, o.position_mm, o.weight, o.target);
        }
        let p = space.parameters.len();
        Self {
            poses,
            moved: space.parameters.iter().map(moved).collect(),
            robot: OneRobot::new(space.reference.links.len()),
            model: space.reference.clone(),
            deviation: vec![0.0; p],
            raw: vec![[Lanes::ZERO; 3]; p],
            space,
        }
    }

    /// With another code path; the bits are the same.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.robot = self.robot.with_instructions(instructions);
        self
    }

    /// Number of residuals.
    pub fn n_rows(&self) -> usize {
        self.poses.n_rows()
    }

    /// sqrt(weight) · (measured − predicted) at some coordinates.
    pub fn residuals(&mut self, coordinates: &[f64], residuals: &mut [f64]) {
        self.place(coordinates);
        self.robot.residuals(&self.poses, residuals);
    }

    /// As [`Self::residuals`], with their derivatives with respect to the coordinates, column-major.
    pub fn linearise(&mut self, coordinates: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        self.place(coordinates);
        let left = left_jacobian(&self.space.base_rotation(&self.deviation));
        let along = Along {
            moved: &self.moved,
            directions: self.space.directions().as_slice(),
            left_jacobian: &left,
        };
        self.robot
            .linearise(&self.poses, &along, &mut self.raw, residuals, jacobian);
    }

    /// The model at the last coordinates.
    pub fn model(&self) -> &KinematicModel {
        &self.model
    }

    fn place(&mut self, coordinates: &[f64]) {
        self.space.deviation_into(coordinates, &mut self.deviation);
        apply_into(
            &self.space.reference,
            &self.space.parameters,
            &self.deviation,
            &mut self.model,
        );
        self.robot.set(
            &self.model.t_instrument_base,
            &self.model.links,
            &self.model.targets_mm,
        );
    }
}
