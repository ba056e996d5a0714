//! Rotation rows of a measured pose: the rotation vector from the predicted to the measured target, and its derivatives.

use crate::identification::model::parameters::{Parameter, Quantity, left_jacobian, rotation_log};
use crate::kinematics::PositionJacobian;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Measured rotation of a pose's target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredRotation {
    /// The target in the measuring frame.
    pub rotation: Rotation3<f64>,
    /// Length that converts an angle to the scale of positions, mm/rad: the standard deviation of a position coordinate, divided by that of
    /// a component of the rotation vector.
    pub mm_per_rad: f64,
    /// The point, in the target's frame, mm, at which the noise of the position is independent of the noise of the rotation: the target
    /// itself (zero), or the board that a camera on the robot sees.
    pub lever_mm: Vector3<f64>,
}

/// w = log(R_predictedᵀ · R_measured): the rotation from the predicted to the measured target, about axes of the target, rad.
pub fn rotation_residual_rad(
    predicted: &Rotation3<f64>,
    measured: &MeasuredRotation,
) -> Vector3<f64> {
    rotation_log(&(predicted.inverse() * measured.rotation))
}

/// Small motion of a target per unit of its cause, in the measuring frame: a shift, and a rotation vector.
#[derive(Clone, Copy, Default)]
pub struct Moved {
    /// mm.
    pub shift: Vector3<f64>,
    /// rad.
    pub turn: Vector3<f64>,
}

impl Moved {
    /// A shift and a rotation.
    pub fn new(shift: Vector3<f64>, turn: Vector3<f64>) -> Self {
        Self { shift, turn }
    }

    fn shifted(shift: Vector3<f64>) -> Self {
        Self::new(shift, Vector3::zeros())
    }
}

/// Motions of a target at one pose by each parameter.
pub struct MovedBy<'a> {
    at: &'a PositionJacobian,
    base_shift: Matrix3<f64>,
    base_turn: Matrix3<f64>,
    target_turn: Matrix3<f64>,
    target: usize,
}

impl<'a> MovedBy<'a> {
    /// `base` and `of_target` are the left Jacobians of the rotation vectors of base and target relative to the reference.
    pub fn new(
        at: &'a PositionJacobian,
        base: Matrix3<f64>,
        of_target: Matrix3<f64>,
        target: usize,
    ) -> Self {
        Self {
            at,
            base_shift: at.base_rotation * base,
            base_turn: base,
            target_turn: at.target * of_target,
            target,
        }
    }

    /// Motion of the target per mm or rad of a parameter.
    pub fn parameter(&self, parameter: &Parameter) -> Moved {
        let link = |link: usize| &self.at.links[link];
        match *parameter {
            Parameter::Link(i, Quantity::A) => Moved::shifted(link(i).a),
            Parameter::Link(i, Quantity::Alpha) => Moved::new(link(i).alpha, link(i).a),
            Parameter::Link(i, Quantity::D) => Moved::shifted(link(i).d),
            Parameter::Link(i, Quantity::ThetaOffset) => {
                Moved::new(link(i).theta_offset, link(i).d)
            }
            Parameter::Link(i, Quantity::Beta) => Moved::new(link(i).beta, link(i).beta_axis),
            Parameter::BaseTranslation(axis) => Moved::shifted(Vector3::ith(axis, 1.0)),
            Parameter::BaseRotation(axis) => Moved::new(
                self.base_shift.column(axis).into(),
                self.base_turn.column(axis).into(),
            ),
            Parameter::Target(target, axis) if target == self.target => {
                Moved::shifted(self.at.target.column(axis).into())
            }
            Parameter::TargetRotation(target, axis) if target == self.target => {
                Moved::new(Vector3::zeros(), self.target_turn.column(axis).into())
            }
            Parameter::Target(..) | Parameter::TargetRotation(..) => Moved::default(),
        }
    }
}

/// Matrix that converts a small rotation δ of the prediction to the change of its rotation rows. With w = log(E), E = R_predᵀ·R_meas:
/// log(exp(−R_predᵀ·δ)·E) = w − J(w)⁻¹·R_predᵀ·δ, with J the left Jacobian [Chirikjian 2011, eq. 10.86]. The residual changes by the
/// negative.
pub fn rows_by_turn(predicted: &Rotation3<f64>, measured: &MeasuredRotation) -> Matrix3<f64> {
    let w = rotation_residual_rad(predicted, measured);
    // Singular only at whole turns, but w is at most half a turn.
    let inverse = left_jacobian(&w)
        .try_inverse()
        .unwrap_or_else(Matrix3::identity);
    inverse * predicted.matrix().transpose()
}
