//! Residuals and their derivatives in a search space, for least squares: prepared once per fit, evaluated without allocating.

use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::reach_mm;
use crate::identification::model::identifiability::{Decomposition, VISIBLE_PER_REACH, decompose};
use crate::identification::model::objective::Observation;
use crate::identification::model::objective::weighted_jacobian;
use crate::identification::model::parameters::Parameter;
use crate::identification::model::parameters::moved;
use crate::identification::model::parameters::{apply_into, left_jacobian};
use crate::identification::model::priors::{PriorRows, Priors};
use crate::identification::model::search_space::SearchSpace;
use crate::kinematics::batch::{Along, InstructionSet, Lanes, Moved, OneRobot, PoseLanes};
use nalgebra::{DMatrix, Vector3};
use std::borrow::Cow;

/// The residuals of some observations as a function of a space's coordinates. Rows are in the order of [`PoseLanes`]. Rows of missing poses are zero,
/// so that sums over all rows equal those of `objective.rs`.
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

    /// As [`Self::new`], with the space's parameters themselves as coordinates, mm or rad.
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

    /// Selects another code path; the results are the same to the last bit.
    pub fn with_instructions(mut self, instructions: InstructionSet) -> Self {
        self.robot = self.robot.with_instructions(instructions);
        self
    }

    /// Number of residuals.
    pub fn n_rows(&self) -> usize {
        self.poses.n_rows()
    }

    /// sqrt(weight) · (measured − predicted) at the given coordinates.
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

/// Decomposition of the scaled identification Jacobian at a model.
pub fn decomposition_at(
    model: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
) -> Decomposition {
    decompose(
        scaled_jacobian_at(model, parameters, scale, observations),
        scale,
        VISIBLE_PER_REACH * reach_mm(&model.links, observations.iter()),
    )
}

/// The identification Jacobian at a model: displacement of points, mm, for one scale of each parameter, over sqrt(N points). For poses the rotation
/// rows are included.
pub fn scaled_jacobian_at(
    model: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
) -> DMatrix<f64> {
    let per_point = 1.0 / (observations.len().max(1) as f64).sqrt();
    let shares: Vec<f64> = scale.iter().map(|s| s * per_point).collect();
    // The kernel used below supports one weight per point only.
    let is_directional = |o: &Observation| o.whitening.is_some();
    if observations
        .iter()
        .any(|o| o.n_rows(model) > 3 || is_directional(o))
    {
        let mut scaled = weighted_jacobian(model, parameters, observations, &Vector3::zeros());
        let columns = scaled.column_iter_mut().zip(&shares);
        columns.for_each(|(mut column, share)| column *= *share);
        return scaled;
    }
    let space = SearchSpace::raw(model.clone(), parameters.to_vec(), shares);
    let mut linearisation = Linearisation::new(&space, observations);
    let n_rows = linearisation.n_rows();
    let mut scaled = DMatrix::zeros(n_rows, parameters.len());
    linearisation.linearise(
        &vec![0.0; parameters.len()],
        &mut vec![0.0; n_rows],
        scaled.as_mut_slice(),
    );
    scaled
}

impl SearchSpace {
    /// A space with one coordinate per observable combination: deviation = S·V·coordinate, with J·S = U·Σ·Vᵀ at the reference. Its box is
    /// the rotated box of the parameters; a uniform cube has the same spread in every direction.
    pub fn singular(
        reference: KinematicModel,
        parameters: Vec<Parameter>,
        scale: Vec<f64>,
        observations: &[Observation],
    ) -> Self {
        let decomposition = decomposition_at(&reference, &parameters, &scale, observations);
        Self::along(
            reference,
            parameters,
            scale,
            decomposition.observable_directions(),
        )
    }

    /// As [`Self::singular`], from the points and the priors together: one coordinate per combination that either of them determines.
    pub fn singular_with_priors(
        reference: KinematicModel,
        parameters: Vec<Parameter>,
        scale: Vec<f64>,
        observations: &[Observation],
        priors: &Priors,
    ) -> Self {
        let decomposition = decomposition_at(&reference, &parameters, &scale, observations);
        let (directions, _) = decomposition.directions_with_priors(&priors.stds());
        let known = priors.from(&reference);
        let rows = rows_along(&reference, &parameters, &directions, observations, &known);
        let turned = &directions * decompose(rows, &vec![1.0; directions.ncols()], 0.0).directions;
        Self::along(reference, parameters, scale, turned).with_priors(known)
    }
}

/// Derivatives of points and priors along some directions, weighted, mm.
fn rows_along(
    reference: &KinematicModel,
    parameters: &[Parameter],
    directions: &DMatrix<f64>,
    observations: &[Observation],
    known: &PriorRows,
) -> DMatrix<f64> {
    let of_points =
        weighted_jacobian(reference, parameters, observations, &Vector3::zeros()) * directions;
    let n = of_points.nrows();
    let mut rows = of_points.resize_vertically(n + known.all.len(), 0.0);
    for (k, prior) in known.all.iter().enumerate() {
        rows.row_mut(n + k)
            .copy_from(&(directions.row(prior.parameter) * known.weight(prior)));
    }
    rows
}
