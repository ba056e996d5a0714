//! The analytic identification Jacobian: derivatives of a target's position with respect to every kinematic parameter.
//!
//! Each parameter is a screw about or along an axis of the chain at that place. Its column is the axis itself (lengths) or axis × lever arm (angles);
//! see Craig, Introduction to Robotics, ch. 5, for the pattern.

use crate::kinematics::forward::t_previous_link;
use crate::kinematics::model::Link;
use nalgebra::{IsometryMatrix3, Matrix3, Vector3};

/// Derivatives of one target position with respect to one link's parameters, in the measuring frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkColumns {
    /// ∂p/∂a, mm/mm.
    pub a: Vector3<f64>,
    /// ∂p/∂alpha, mm/rad.
    pub alpha: Vector3<f64>,
    /// ∂p/∂d, mm/mm.
    pub d: Vector3<f64>,
    /// ∂p/∂theta_offset, mm/rad.
    pub theta_offset: Vector3<f64>,
    /// ∂p/∂beta, mm/rad.
    pub beta: Vector3<f64>,
    /// Axis of beta. Those of alpha and theta_offset are `a` and `d`.
    pub beta_axis: Vector3<f64>,
}

/// One target position and its derivatives, in the measuring frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionJacobian {
    /// The position itself, mm.
    pub position_mm: Vector3<f64>,
    /// One entry per link.
    pub links: Vec<LinkColumns>,
    /// ∂p/∂w for a small rotation vector w of the base about its own origin, axes of the measuring frame, mm/rad.
    /// The derivative with respect to the base's translation is the identity.
    pub base_rotation: Matrix3<f64>,
    /// ∂p/∂(target offset in the flange frame): the flange's rotation.
    pub target: Matrix3<f64>,
}

/// Position of a target and its derivatives for one pose. `q_rad` holds one value per link.
pub fn position_jacobian(
    t_instrument_base: &IsometryMatrix3<f64>,
    links: &[Link],
    q_rad: &[f64],
    p_flange_target_mm: &Vector3<f64>,
) -> PositionJacobian {
    let mut chain = Vec::with_capacity(links.len() + 1);
    chain.push(*t_instrument_base);
    for (link, q) in links.iter().zip(q_rad) {
        chain.push(chain[chain.len() - 1] * t_previous_link(link, *q));
    }
    let flange = chain[links.len()];
    let p = flange.rotation * p_flange_target_mm + flange.translation.vector;
    let columns = links
        .iter()
        .enumerate()
        .map(|(i, link)| link_columns(link, &chain[i], &chain[i + 1], &p))
        .collect();
    PositionJacobian {
        links: columns,
        ..placement_jacobian(t_instrument_base, &flange, p_flange_target_mm)
    }
}

/// As [`position_jacobian`], for a robot whose flange is known in the measuring frame. There are no derivatives by links.
pub fn placement_jacobian(
    t_instrument_base: &IsometryMatrix3<f64>,
    t_instrument_flange: &IsometryMatrix3<f64>,
    p_flange_target_mm: &Vector3<f64>,
) -> PositionJacobian {
    let flange = t_instrument_flange;
    let p = flange.rotation * p_flange_target_mm + flange.translation.vector;
    let lever = p - t_instrument_base.translation.vector;
    PositionJacobian {
        position_mm: p,
        links: vec![],
        base_rotation: -lever.cross_matrix(),
        target: *flange.rotation.matrix(),
    }
}

/// Columns of link i from the frames before and after it; `p` is the target's position.
pub fn link_columns(
    link: &Link,
    before: &IsometryMatrix3<f64>,
    after: &IsometryMatrix3<f64>,
    p: &Vector3<f64>,
) -> LinkColumns {
    let x_before: Vector3<f64> = before.rotation.matrix().column(0).into();
    let z_after: Vector3<f64> = after.rotation.matrix().column(2).into();
    let origin_before = before.translation.vector;
    let origin_after = after.translation.vector;
    // y axis after Rx(alpha): the axis of beta, through the point reached after Dx(a)
    let (s, c) = libm::sincos(link.alpha_rad);
    let y_beta = before.rotation * Vector3::new(0.0, c, s);
    let origin_beta = origin_before + x_before * link.a_mm;
    LinkColumns {
        a: x_before,
        alpha: x_before.cross(&(p - origin_before)),
        d: z_after,
        theta_offset: z_after.cross(&(p - origin_after)),
        beta: y_beta.cross(&(p - origin_beta)),
        beta_axis: y_beta,
    }
}
