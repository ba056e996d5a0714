//! Forward kinematics, the readable reference: the fast kernel in `batch/` is tested against it.

use crate::kinematics::model::Link;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

/// Rotation about x by `angle_rad`.
fn rx(angle_rad: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle_rad);
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

/// Rotation about y by `angle_rad`.
fn ry(angle_rad: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle_rad);
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// Rotation about z by `angle_rad`.
fn rz(angle_rad: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle_rad);
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// Link frame i in link frame i-1 [Gao 2018, eq. 3], with Hayati's beta:
/// `T_{i-1,i} = Rx(alpha) · Dx(a) · Ry(beta) · Rz(q + theta_offset) · Dz(d)`. Lengths in mm.
pub fn t_previous_link(link: &Link, q_rad: f64) -> IsometryMatrix3<f64> {
    let r_alpha = rx(link.alpha_rad);
    let r_beta = ry(link.beta_rad);
    let rotation = r_alpha * r_beta * rz(q_rad + link.theta_offset_rad);
    let translation = r_alpha * (Vector3::new(link.a_mm, 0.0, 0.0) + r_beta.column(2) * link.d_mm);
    IsometryMatrix3::from_parts(
        Translation3::from(translation),
        Rotation3::from_matrix_unchecked(rotation),
    )
}

/// Flange in the base frame: the product over the links [Gao 2018, eq. 2, 4]. `q_rad` holds one value per link.
pub fn t_base_flange(links: &[Link], q_rad: &[f64]) -> IsometryMatrix3<f64> {
    assert_eq!(links.len(), q_rad.len(), "one joint value per link");
    links
        .iter()
        .zip(q_rad)
        .fold(IsometryMatrix3::identity(), |t_base_link, (link, q)| {
            t_base_link * t_previous_link(link, *q)
        })
}

/// Position of a target in the base frame, mm; `p_flange_target_mm` is its position in the flange frame.
pub fn forward_kinematics(
    links: &[Link],
    q_rad: &[f64],
    p_flange_target_mm: &Vector3<f64>,
) -> Vector3<f64> {
    let t = t_base_flange(links, q_rad);
    t.rotation * p_flange_target_mm + t.translation.vector
}
