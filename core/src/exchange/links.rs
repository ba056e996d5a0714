//! Converts the axes of a chain to links in Craig's convention, with Hayati's beta for nearly parallel neighbouring axes.

use crate::exchange::chain::{Axis, Chain};
use crate::identification::model::parameters::PARALLEL_SINE;
use crate::kinematics::Link;
use crate::kinematics::forward::t_previous_link;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

/// Lengths and cosines below this are rounding.
const ROUNDING: f64 = 1e-9;

/// Links, with the transforms before the first and after the last one: T_root_tip(q) = `t_root_base` · Π links(q) · `t_flange_tip`.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedLinks {
    /// Frame 0 of the links in the chain's root, mm.
    pub t_root_base: IsometryMatrix3<f64>,
    /// One per moving joint.
    pub links: Vec<Link>,
    /// The chain's tip in the flange (frame n of the links), mm.
    pub t_flange_tip: IsometryMatrix3<f64>,
}

/// Links with the kinematics of a chain, at the chain's own joint values.
///
/// Frame i is on axis i, with x along the common normal to axis i + 1 (Craig, Introduction to Robotics, section 3.4). If the two axes are
/// nearly parallel, the normal is far away; x then points to the intersection of axis i + 1 with the plane perpendicular to axis i (Hayati
/// & Mirmirani 1985). The base is on axis 1 at the foot of the perpendicular from the root's origin, the flange on the last axis at the
/// foot of the perpendicular from the tip's origin. The base's z is along axis 1, or along the root's z if axis 1 points the other way
/// (KUKA), so that a robot on the floor has an upright base.
///
/// # Panics
/// If no joint moves.
pub fn links_of_chain(chain: &Chain) -> ImportedLinks {
    let axes = chain.axes();
    let t_root_tip = chain.t_root_tip(&vec![0.0; axes.len()]);
    let is_upside_down = axes[0].direction.z < ROUNDING - 1.0;
    // The base's x axis must intersect axis 1, which may be off the vertical by the rounding of the description. The base is therefore
    // where axis 1 intersects the root's plane z = 0.
    let first = &axes[0];
    let upright = Axis {
        direction: Vector3::z(),
        point_mm: first.point_mm - first.direction * (first.point_mm.z / first.direction.z),
    };
    let base_axis = if is_upside_down { &upright } else { &axes[0] };
    let t_root_base = on_axis(base_axis, &Vector3::zeros(), [Vector3::x(), Vector3::y()]);
    let mut links: Vec<Link> = Vec::with_capacity(axes.len());
    // The frame after Rx(alpha)·Dx(a)·Ry(beta) of the current link.
    let mut to_axis = match is_upside_down {
        true => reaching(&t_root_base, &axes[0]),
        false => Link::default(),
    };
    let mut before = t_root_base * t_previous_link(&to_axis, 0.0);
    for (i, axis) in axes.iter().enumerate() {
        let old_x: Vector3<f64> = before.rotation.matrix().column(0).into();
        let wanted = match axes.get(i + 1) {
            Some(next) => towards(axis, next, &before.translation.vector, &old_x),
            None => {
                let columns = [0, 1].map(|k| t_root_tip.rotation.matrix().column(k).into());
                on_axis(axis, &t_root_tip.translation.vector, columns)
            }
        };
        let seen = before.inverse() * wanted;
        let turned: Vector3<f64> = seen.rotation.matrix().column(0).into();
        let link = Link {
            theta_offset_rad: libm::atan2(turned.y, turned.x),
            d_mm: seen.translation.vector.z,
            ..to_axis
        };
        let at_link = before
            * t_previous_link(
                &Link {
                    d_mm: link.d_mm,
                    theta_offset_rad: link.theta_offset_rad,
                    ..Link::default()
                },
                0.0,
            );
        links.push(link);
        before = at_link;
        if let Some(next) = axes.get(i + 1) {
            to_axis = reaching(&at_link, next);
            before = at_link * t_previous_link(&to_axis, 0.0);
        }
    }
    ImportedLinks {
        t_root_base,
        links,
        t_flange_tip: before.inverse() * t_root_tip,
    }
}

/// A frame on an axis at the foot of the perpendicular from a point. Of the two directions, the first one that is not along the axis
/// determines x: x is its part across the axis.
fn on_axis(
    axis: &Axis,
    point_mm: &Vector3<f64>,
    directions: [Vector3<f64>; 2],
) -> IsometryMatrix3<f64> {
    let z = axis.direction;
    let along = |d: &Vector3<f64>| d.dot(&z).abs();
    let x = if along(&directions[0]) < 0.9 {
        directions[0]
    } else {
        directions[1]
    };
    framed(
        axis.point_mm + z * (point_mm - axis.point_mm).dot(&z),
        &x,
        &z,
    )
}

/// A frame with this origin and z. x is the part of `x` perpendicular to z.
fn framed(origin_mm: Vector3<f64>, x: &Vector3<f64>, z: &Vector3<f64>) -> IsometryMatrix3<f64> {
    let x = (x - z * x.dot(z)).normalize();
    let rotation = Matrix3::from_columns(&[x, z.cross(&x), *z]);
    IsometryMatrix3::from_parts(
        Translation3::from(origin_mm),
        Rotation3::from_matrix_unchecked(rotation),
    )
}

/// The frame on `axis` from which `next` is reached by Rx·Dx·Ry.
fn towards(
    axis: &Axis,
    next: &Axis,
    from_mm: &Vector3<f64>,
    old_x: &Vector3<f64>,
) -> IsometryMatrix3<f64> {
    let (z, v) = (axis.direction, next.direction);
    let normal = z.cross(&v);
    let between = next.point_mm - axis.point_mm;
    if normal.norm() < PARALLEL_SINE {
        // Intersection of the next axis with the plane perpendicular to this one.
        let origin = axis.point_mm + z * (from_mm - axis.point_mm).dot(&z);
        let pierced = next.point_mm + v * ((origin - next.point_mm).dot(&z) / v.dot(&z));
        let x = pierced - origin;
        return framed(origin, if x.norm() > ROUNDING { &x } else { old_x }, &z);
    }
    let square = normal.norm_squared();
    let origin = axis.point_mm + z * (between.cross(&v).dot(&normal) / square);
    let length = between.dot(&normal) / normal.norm();
    let is_forward = if length.abs() > ROUNDING {
        length > 0.0
    } else {
        normal.dot(old_x) >= -ROUNDING
    };
    framed(origin, &(if is_forward { normal } else { -normal }), &z)
}

/// Rx(alpha)·Dx(a)·Ry(beta) from frame i to axis i + 1; the x axis of frame i intersects that axis.
fn reaching(t_root_link: &IsometryMatrix3<f64>, next: &Axis) -> Link {
    let v = t_root_link.rotation.inverse() * next.direction;
    let p = t_root_link.inverse() * nalgebra::Point3::from(next.point_mm);
    let across = (v.y * v.y + v.z * v.z).sqrt();
    // The x at which the axis is closest to the frame's x axis.
    let along = -(p.y * v.y + p.z * v.z) / (across * across);
    let beta = libm::atan2(v.x, across);
    Link {
        a_mm: p.x + v.x * along,
        // Half a turn is written as 180°, not −180°.
        alpha_rad: libm::atan2(if v.y.abs() < ROUNDING_RAD { 0.0 } else { -v.y }, v.z),
        beta_rad: if beta.abs() < ROUNDING_RAD { 0.0 } else { beta },
        ..Link::default()
    }
}

/// Angles below this are rounding.
const ROUNDING_RAD: f64 = 1e-14;
