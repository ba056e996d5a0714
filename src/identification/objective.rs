//! The cost F and its residuals [Gao 2018, eq. 8, 11], with the identification Jacobian.

use crate::identification::KinematicModel;
use crate::identification::parameters::{Parameter, Quantity, left_jacobian};
use crate::kinematics::{PositionJacobian, position_jacobian};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// One measured pose, ready to fit: joint values in the model's convention, position in the measuring frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// Joint values of the model, rad.
    pub q_rad: Vec<f64>,
    /// Measured position, mm.
    pub position_mm: Vector3<f64>,
    /// Which target.
    pub target: usize,
    /// Weight of the squared residual; 1 unless the points carry their own uncertainties.
    pub weight: f64,
}

/// residual = measured − predicted of each observation, mm, unweighted.
pub fn residuals(model: &KinematicModel, observations: &[Observation]) -> Vec<Vector3<f64>> {
    observations
        .iter()
        .map(|o| o.position_mm - model.position(&o.q_rad, o.target))
        .collect()
}

/// F = Σ weight · |residual|², mm² [Gao 2018, eq. 8, 11].
pub fn cost(model: &KinematicModel, observations: &[Observation]) -> f64 {
    residuals(model, observations)
        .iter()
        .zip(observations)
        .map(|(r, o)| o.weight * r.norm_squared())
        .sum()
}

/// sqrt(weight) · residual, three rows per observation.
pub fn weighted_residuals(model: &KinematicModel, observations: &[Observation]) -> DVector<f64> {
    let residuals = residuals(model, observations);
    DVector::from_fn(3 * observations.len(), |row, _| {
        observations[row / 3].weight.sqrt() * residuals[row / 3][row % 3]
    })
}

/// The identification Jacobian: sqrt(weight) · ∂(predicted position)/∂(parameter), 3·N × p, in mm per mm or rad. The derivative of the
/// residual is its negative. `base_rotation_rad` is the rotation vector by which `model`'s base differs from the reference that the
/// deviations are counted from (zero at the reference).
pub fn weighted_jacobian(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
    base_rotation_rad: &Vector3<f64>,
) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(3 * observations.len(), parameters.len());
    let left = left_jacobian(base_rotation_rad);
    for (row, observation) in observations.iter().enumerate() {
        let target = &model.targets_mm[observation.target];
        let at = position_jacobian(
            &model.t_instrument_base,
            &model.links,
            &observation.q_rad,
            target,
        );
        let turned = at.base_rotation * left;
        let root = observation.weight.sqrt();
        for (column, parameter) in parameters.iter().enumerate() {
            let derivative = derivative_by(parameter, &at, &turned, observation.target);
            for axis in 0..3 {
                jacobian[(3 * row + axis, column)] = root * derivative[axis];
            }
        }
    }
    jacobian
}

/// ∂(predicted position)/∂(parameter) of one pose that sees `target`, mm per mm or rad. `turned` is the derivative by the base's rotation vector.
pub fn derivative_by(
    parameter: &Parameter,
    at: &PositionJacobian,
    turned: &Matrix3<f64>,
    target: usize,
) -> Vector3<f64> {
    match *parameter {
        Parameter::Link(link, Quantity::A) => at.links[link].a,
        Parameter::Link(link, Quantity::Alpha) => at.links[link].alpha,
        Parameter::Link(link, Quantity::D) => at.links[link].d,
        Parameter::Link(link, Quantity::ThetaOffset) => at.links[link].theta_offset,
        Parameter::Link(link, Quantity::Beta) => at.links[link].beta,
        Parameter::BaseTranslation(axis) => Vector3::ith(axis, 1.0),
        Parameter::BaseRotation(axis) => turned.column(axis).into(),
        Parameter::Target(other, _) if other != target => Vector3::zeros(),
        Parameter::Target(_, axis) => at.target.column(axis).into(),
    }
}
