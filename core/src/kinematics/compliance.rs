//! Forward kinematics with corrections, in readable form:
//!
//! `T_base_flange = Trans(net(q)) · Rot(B ∘ M₀) · Π [Rx(α)·Dx(a)·Ry(β)·Rz(q + θ + C·q + h(q))·Dz(d)·Rot(K_i ∘ M_i)]`
//!
//! with the moments of gravity `M_i = R_iᵀ·Σ_{j≥i} [m_j·(o_j − o_i) + R_j·c_j] × g` about the origin of frame i, in its axes, and M₀ the same about
//! the base's origin. Rot(w) is the rotation of a rotation vector, ∘ the product axis by axis, C·q the coupling of the joints, h the joint's
//! harmonics, o_j and R_j origin and axes of frame j in the base frame. Moments are computed on the chain without corrections (deflection moves the
//! masses by a thousandth) and with lengths in metres.

use crate::kinematics::corrections::{Compliance, Corrections};
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::model::Link;
use crate::kinematics::rotation::rotation_exp;
use nalgebra::{IsometryMatrix3, Translation3, Vector3};

/// Millimetres in a metre.
const MM: f64 = 1e3;

/// Moments of gravity at one pose, mass units × metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// M₀ about the base's origin, in the base frame.
    pub base: Vector3<f64>,
    /// M_i about the origin of each link's frame, in that frame.
    pub joints: Vec<Vector3<f64>>,
}

/// Frames of all links in the base frame, without corrections.
pub fn rigid_chain(links: &[Link], q_rad: &[f64]) -> Vec<IsometryMatrix3<f64>> {
    assert_eq!(links.len(), q_rad.len(), "one joint value per link");
    let mut t_base_link = IsometryMatrix3::identity();
    let mut next = |(link, q): (&Link, &f64)| {
        t_base_link *= t_previous_link(link, *q);
        t_base_link
    };
    links.iter().zip(q_rad).map(&mut next).collect()
}

/// First moments of the masses under gravity, in the axes of the base frame, mass units × metres.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstMoments {
    /// First moment of all masses about the base's origin.
    pub base: Vector3<f64>,
    /// First moment of the masses from each link outwards, about the origin of its frame.
    pub joints: Vec<Vector3<f64>>,
}

/// First moments for the frames of [`rigid_chain`].
pub fn first_moments(chain: &[IsometryMatrix3<f64>], compliance: &Compliance) -> FirstMoments {
    // mass from the flange inwards, and its first moment about the base's origin
    let (mut mass, mut about_base) = (0.0, Vector3::zeros());
    if let (Some(payload), Some(flange)) = (&compliance.payload, chain.last()) {
        mass = payload.mass_kg / compliance.mass_unit_kg;
        about_base =
            (flange.rotation * payload.centre_mm + flange.translation.vector) * (mass / MM);
    }
    let mut joints = vec![Vector3::zeros(); chain.len()];
    for (j, frame) in chain.iter().enumerate().rev() {
        let origin_m = frame.translation.vector / MM;
        mass += compliance.masses[j];
        about_base +=
            origin_m * compliance.masses[j] + frame.rotation * compliance.first_moments_m[j];
        joints[j] = about_base - origin_m * mass;
    }
    FirstMoments {
        base: about_base,
        joints,
    }
}

/// The moments of gravity about the base and every joint, from the frames of [`rigid_chain`].
pub fn moments(chain: &[IsometryMatrix3<f64>], compliance: &Compliance) -> Moments {
    let g = &compliance.gravity_in_base;
    let first = first_moments(chain, compliance);
    let joints = chain
        .iter()
        .zip(&first.joints)
        .map(|(frame, s)| frame.rotation.inverse() * s.cross(g))
        .collect();
    Moments {
        base: first.base.cross(g),
        joints,
    }
}

/// Flange in the base frame, with corrections. Without any correction it equals [`t_base_flange`](crate::kinematics::t_base_flange).
pub fn t_base_flange_corrected(
    links: &[Link],
    corrections: &Corrections,
    q_rad: &[f64],
) -> IsometryMatrix3<f64> {
    let compliance = &corrections.compliance;
    let moments = moments(&rigid_chain(links, q_rad), compliance);
    let base_turn = rotation_exp(&compliance.base_rad.component_mul(&moments.base));
    let mut t_base_link = IsometryMatrix3::from_parts(Translation3::identity(), base_turn);
    for (i, (link, q)) in links.iter().zip(q_rad).enumerate() {
        t_base_link *= t_previous_link(link, q + corrections.joint_error_rad(i, q_rad));
        t_base_link.rotation *=
            rotation_exp(&compliance.joints_rad[i].component_mul(&moments.joints[i]));
    }
    if let Some(network) = &corrections.residual {
        t_base_link.translation.vector += network.displacement_mm(q_rad);
    }
    t_base_link
}
