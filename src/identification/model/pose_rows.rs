//! Rotation rows of a measured pose: the rotation vector from the predicted to the measured target, and its derivatives.

use crate::identification::model::parameters::{Parameter, Quantity, left_jacobian, rotation_log};
use crate::kinematics::PositionJacobian;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Measured rotation of a pose's target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredRotation {
    /// The target in the measuring frame.
    pub rotation: Rotation3<f64>,
    /// Length that converts an angle to the scale of positions: the standard deviation of a coordinate of the position over that of one of the
    /// rotation vector, mm/rad.
    pub mm_per_rad: f64,
    /// The point, in the target's frame, whose measured position has noise that is independent of that of the rotation, mm. It is the target itself
    /// (zero), or the board that a carried camera sees.
    pub lever_mm: Vector3<f64>,
}

/// w = log(R_predictedᵀ · R_measured): the rotation from the predicted to the measured target, about axes of the target, rad.
pub fn rotation_residual_rad(
    predicted: &Rotation3<f64>,
    measured: &MeasuredRotation,
) -> Vector3<f64> {
    rotation_log(&(predicted.inverse() * measured.rotation))
}

/// Rotations of a target: the axis of each parameter, in the measuring frame.
pub struct TurnedBy<'a> {
    at: &'a PositionJacobian,
    base: Matrix3<f64>,
    of_target: Matrix3<f64>,
    target: usize,
}

impl<'a> TurnedBy<'a> {
    /// `base` and `of_target` are the left Jacobians of the rotation vectors of base and target relative to the reference.
    pub fn new(
        at: &'a PositionJacobian,
        base: Matrix3<f64>,
        of_target: Matrix3<f64>,
        target: usize,
    ) -> Self {
        Self {
            at,
            base,
            of_target: at.target * of_target,
            target,
        }
    }

    /// Small rotation of the target, in the measuring frame, per unit of a parameter: rad/mm or rad/rad.
    pub fn axis(&self, parameter: &Parameter) -> Vector3<f64> {
        match *parameter {
            Parameter::Link(link, Quantity::Alpha) => self.at.links[link].a,
            Parameter::Link(link, Quantity::ThetaOffset) => self.at.links[link].d,
            Parameter::Link(link, Quantity::Beta) => self.at.links[link].beta_axis,
            Parameter::BaseRotation(axis) => self.base.column(axis).into(),
            Parameter::TargetRotation(target, axis) if target == self.target => {
                self.of_target.column(axis).into()
            }
            Parameter::Link(_, Quantity::A | Quantity::D)
            | Parameter::BaseTranslation(_)
            | Parameter::Target(..)
            | Parameter::TargetRotation(..) => Vector3::zeros(),
        }
    }

    /// As [`rows_by_turn`].
    pub fn rows(&self, predicted: &Rotation3<f64>, measured: &MeasuredRotation) -> Matrix3<f64> {
        rows_by_turn(predicted, measured)
    }
}

/// From a small rotation δ of the prediction to the change of the prediction's rows. With w = log(E), E = R_predᵀ·R_meas: log(exp(−R_predᵀ·δ)·E) = w
/// − J(w)⁻¹·R_predᵀ·δ, J the left Jacobian [Chirikjian 2011, eq. 10.86]. The residual changes by the negative.
pub fn rows_by_turn(predicted: &Rotation3<f64>, measured: &MeasuredRotation) -> Matrix3<f64> {
    let w = rotation_residual_rad(predicted, measured);
    // singular only at whole turns; w is at most half a turn
    let inverse = left_jacobian(&w)
        .try_inverse()
        .unwrap_or_else(Matrix3::identity);
    inverse * predicted.matrix().transpose()
}
