//! Rotations and their rotation vectors.

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// Rotation for a rotation vector (Rodrigues' formula).
pub fn rotation_exp(w: &Vector3<f64>) -> Rotation3<f64> {
    let angle = w.norm();
    let k = w.cross_matrix();
    let (a, b) = if angle < SMALL_ANGLE_RAD {
        (1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0)
    } else {
        (
            libm::sin(angle) / angle,
            (1.0 - libm::cos(angle)) / (angle * angle),
        )
    };
    Rotation3::from_matrix_unchecked(Matrix3::identity() + k * a + k * k * b)
}

/// The same angle without whole turns: at most half a turn to either side.
pub fn within_half_a_turn(angle_rad: f64) -> f64 {
    angle_rad - TAU * (angle_rad / TAU).round()
}

/// Rotation vector of a rotation: the inverse of [`rotation_exp`] up to half a turn. It is computed from the quaternion, because the rotation matrix is
/// nearly symmetric near half a turn.
pub fn rotation_log(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let q = UnitQuaternion::from_rotation_matrix(rotation);
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let axis = sign * q.imag();
    match axis.norm() {
        0.0 => axis,
        sine => axis * (2.0 * libm::atan2(sine, sign * q.w) / sine),
    }
}

/// Left Jacobian of SO(3): d(Exp(w)·y)/dw = −[Exp(w)·y]× · J(w) (Chirikjian 2011, eq. 10.86).
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle = w.norm();
    let k = w.cross_matrix();
    let square = angle * angle;
    let (a, b) = if angle < SMALL_ANGLE_RAD {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        (
            (1.0 - libm::cos(angle)) / square,
            (angle - libm::sin(angle)) / (square * angle),
        )
    };
    Matrix3::identity() + k * a + k * k * b
}

/// The rotation nearest to a matrix (orthogonal Procrustes).
pub fn nearest_rotation(m: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    let svd = m.try_svd(true, true, f64::EPSILON, SVD_ITERATIONS)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    Some(Rotation3::from_matrix_unchecked(
        u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t,
    ))
}

/// The pose at the share `share` (0 to 1) of the path between two poses: along the straight line, and about the axis of the relative
/// rotation.
pub fn between(
    from: &IsometryMatrix3<f64>,
    to: &IsometryMatrix3<f64>,
    share: f64,
) -> IsometryMatrix3<f64> {
    let turn = rotation_log(&(to.rotation * from.rotation.inverse())) * share;
    let translation =
        from.translation.vector + (to.translation.vector - from.translation.vector) * share;
    IsometryMatrix3::from_parts(
        Translation3::from(translation),
        rotation_exp(&turn) * from.rotation,
    )
}

/// Below this angle the series of the formulas above is exact to rounding (its next term is angle⁴/1920 < 1e-16 relative).
const SMALL_ANGLE_RAD: f64 = 1e-3;
/// Iteration limit of a singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;
