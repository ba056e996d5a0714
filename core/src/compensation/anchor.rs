//! Unique base and flange of an identified robot, independent of how the identification divided them between links, base and targets.
//!
//! Moving the base has the same effect as other values of link 1. Moving the targets has the same effect as another theta_offset and d of
//! the last link. How a parameter set divides these effects shows nothing about the robot. Base and flange are therefore anchored to the
//! robot's axes: the anchored base frame is the one in which link 1 is nominal, and the anchored flange is the one for which theta_offset
//! and d of the last link are nominal.

use crate::compensation::mode::Base;
use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::usual_length_mm;
use crate::identification::model::parameters::is_parallel;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::{Link, reach_mm};
use nalgebra::{IsometryMatrix3, Vector3};

/// T_identified(q) = `t_base_anchored` · T_anchored(q) · `t_anchored_flange`, where T is the flange in the base frame. Two identifications of one
/// robot have the same T_anchored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// The anchored base in the base frame of the identified links, mm.
    pub t_base_anchored: IsometryMatrix3<f64>,
    /// The flange of the identified links in the anchored flange, mm.
    pub t_anchored_flange: IsometryMatrix3<f64>,
}

/// The same robot with `beta` = 0 for links whose axis is not parallel to the one before. For such links beta is redundant: Rx(α)·Dx(a)·Ry(β) =
/// Rz(φ)·Dz(s)·Rx(α′)·Dx(a′)·Rz(ψ)·Dz(t), the common normal of both axes [Denavit & Hartenberg 1955]. φ and s are added to theta_offset and d of the
/// link before, ψ and t to those of the link itself. Links that are nominally parallel, or that have a nominal beta, do not change.
fn without_redundant_beta(identified: &[Link], nominal: &[Link]) -> Vec<Link> {
    let mut links = identified.to_vec();
    for i in 1..links.len() {
        let (link, is_plain) = (links[i], nominal[i].beta_rad == 0.0);
        if is_parallel(&nominal[i]) || !is_plain || link.beta_rad == 0.0 {
            continue;
        }
        let (sin_alpha, cos_alpha) = libm::sincos(link.alpha_rad);
        let (sin_beta, cos_beta) = libm::sincos(link.beta_rad);
        // The second axis is (sin β, −sin α·cos β, cos α·cos β).
        let across = (sin_beta * sin_beta + (sin_alpha * cos_beta) * (sin_alpha * cos_beta)).sqrt();
        let sin = across.copysign(sin_alpha);
        let cos = cos_alpha * cos_beta;
        let (sin_phi, cos_phi) = (sin_beta / sin, sin_alpha * cos_beta / sin);
        let t = link.a_mm * sin_phi / sin;
        // The x axis of the link before its joint's rotation, relative to the common normal and its perpendicular.
        let along = cos_phi * cos_beta + sin_phi * sin_alpha * sin_beta;
        let beside = cos * (cos_phi * sin_alpha * sin_beta - sin_phi * cos_beta)
            - sin * cos_alpha * sin_beta;
        links[i - 1].theta_offset_rad += libm::atan2(sin_phi, cos_phi);
        links[i - 1].d_mm -= t * cos;
        links[i] = Link {
            a_mm: link.a_mm * cos_phi,
            alpha_rad: libm::atan2(sin, cos),
            beta_rad: 0.0,
            theta_offset_rad: link.theta_offset_rad + libm::atan2(beside, along),
            d_mm: link.d_mm + t,
        };
    }
    links
}

/// The anchor of identified links. With link 1 = P·Rz(q + θ)·Dz(d), P = Rx(α)·Dx(a)·Ry(β), it is B·P̂·Rz(q + θ̂)·Dz(d̂) for B = P·Rz(θ − θ̂)·Dz(d −
/// d̂)·P̂⁻¹, because Rz and Dz commute. The last link is treated in the same way, with E = Rz(θ − θ̂)·Dz(d − d̂) on its right. The d of links whose
/// axes are parallel to the first or to the last one shift along the same direction and are included there.
///
/// # Panics
/// If the robots have not the same number of links.
pub fn anchor(identified: &[Link], nominal: &[Link]) -> Anchor {
    assert_eq!(
        identified.len(),
        nominal.len(),
        "one identified link per nominal link"
    );
    let identified = without_redundant_beta(identified, nominal);
    let last = nominal.len() - 1;
    let (first_group, last_group) = (first_group_end(nominal), last_group_start(nominal));
    let slide = |link: usize| identified[link].d_mm - nominal[link].d_mm;
    // d along axis i shifts along axis 1 (or n) by the product of the cosines in between.
    let cosine = |from: usize, to: usize| {
        nominal[from + 1..=to]
            .iter()
            .map(|l| libm::cos(l.alpha_rad))
            .product::<f64>()
    };
    let at_base: f64 = (0..=first_group)
        .map(|link| cosine(0, link) * slide(link))
        .sum();
    let turned = |link: usize, d_mm: f64| Link {
        theta_offset_rad: identified[link].theta_offset_rad - nominal[link].theta_offset_rad,
        d_mm,
        ..Link::default()
    };
    let before = |link: &Link| {
        t_previous_link(
            &Link {
                theta_offset_rad: 0.0,
                d_mm: 0.0,
                ..*link
            },
            0.0,
        )
    };
    let t_base_anchored = before(&identified[0])
        * t_previous_link(&turned(0, at_base), 0.0)
        * before(&nominal[0]).inverse();
    let t_anchored_flange = if last_group == 0 {
        IsometryMatrix3::identity() // all axes are parallel, so the base contains the shift
    } else {
        let at_flange: f64 = (last_group..=last)
            .map(|link| cosine(link, last) * slide(link))
            .sum();
        t_previous_link(&turned(last, at_flange), 0.0)
    };
    Anchor {
        t_base_anchored,
        t_anchored_flange,
    }
}

/// Last of the links whose axes are parallel to the first.
fn first_group_end(nominal: &[Link]) -> usize {
    (1..nominal.len())
        .take_while(|link| is_parallel(&nominal[*link]))
        .last()
        .unwrap_or(0)
}

/// Largest error of d of the last link, in usual errors of a link. A larger change contains the length of a tool.
const MAX_USUAL_ERRORS: f64 = 3.0;

/// A reflector that the paper's model holds at the flange's origin. If it is really in front of the flange, d of the last link contains its
/// length, and positions do not show how much of the change is an error of the link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldReflector {
    /// Change of d of the last link, mm.
    pub change_mm: f64,
    /// True if the change is too large for an error of the link. It then counts as the reflector's length.
    pub is_length: bool,
    usual_error_mm: f64,
}

impl HeldReflector {
    /// `None` if the identification had the reflectors' positions free.
    pub fn of(identified: &KinematicModel, nominal: &[Link]) -> Option<Self> {
        let is_held = identified.targets_mm.contains(&Vector3::zeros());
        is_held.then(|| Self {
            change_mm: change_of_last_d_mm(&identified.links, nominal),
            is_length: contains_tool(&identified.links, nominal),
            usual_error_mm: usual_error_of_last_d_mm(nominal),
        })
    }

    /// Error of the flange along the last axis if nothing is known about the reflector's length, mm: root mean square of the difference
    /// between what is corrected as an error of the link and the real error, whose standard deviation is the usual one.
    pub fn flange_error_mm(&self) -> f64 {
        let corrected_mm = if self.is_length { 0.0 } else { self.change_mm };
        libm::hypot(self.usual_error_mm, corrected_mm)
    }
}

/// Change of d of the last link, and of those before it that are parallel to it, mm.
fn change_of_last_d_mm(identified: &[Link], nominal: &[Link]) -> f64 {
    let flange = anchor(identified, nominal).t_anchored_flange;
    flange.translation.z
}

/// Usual error of the sum of the d of the last link and of those before it that are parallel to it, mm.
pub fn usual_error_of_last_d_mm(nominal: &[Link]) -> f64 {
    let n = nominal.len() - last_group_start(nominal);
    usual_length_mm(reach_mm(nominal)) * (n as f64).sqrt()
}

/// True if d of the last link contains the length of a tool: it changed by more than the errors of links.
pub fn contains_tool(identified: &[Link], nominal: &[Link]) -> bool {
    let most_mm = MAX_USUAL_ERRORS * usual_error_of_last_d_mm(nominal);
    change_of_last_d_mm(identified, nominal).abs() > most_mm
}

/// The anchor for targets that must be reached in the measuring frame, if positions were measured in the nominal base frame. The base stays
/// where the measurements place it. d of the last link also stays, as the paper's model identifies it with the reflector held at the
/// flange. With `has_tool`, d contains the length of a tool that the nominal robot does not have, and it is anchored.
fn anchor_in_measuring_frame(
    identified: &KinematicModel,
    nominal: &[Link],
    has_tool: bool,
) -> Anchor {
    let of_axes = anchor(&identified.links, nominal);
    let mut t_anchored_flange = of_axes.t_anchored_flange;
    if !has_tool {
        t_anchored_flange.translation.vector.fill(0.0);
    }
    Anchor {
        t_base_anchored: identified.t_instrument_base.inverse(),
        t_anchored_flange,
    }
}

/// The anchor for targets that must be reached in the frame of `base`. `has_tool`: see [`contains_tool`].
///
/// # Panics
/// If the robots have not the same number of links.
pub fn anchor_in(
    base: Base,
    identified: &KinematicModel,
    nominal: &[Link],
    has_tool: bool,
) -> Anchor {
    match base {
        Base::Robot => anchor(&identified.links, nominal),
        Base::Measured => anchor_in_measuring_frame(identified, nominal, has_tool),
    }
}

/// First of the links whose axes are parallel to the last.
fn last_group_start(nominal: &[Link]) -> usize {
    (1..nominal.len())
        .rev()
        .take_while(|link| is_parallel(&nominal[*link]))
        .last()
        .map_or(nominal.len() - 1, |link| link - 1)
}

impl Anchor {
    /// The anchored flange in the anchored base, from the flange of the identified links in their base.
    pub fn anchored(&self, t_base_flange: &IsometryMatrix3<f64>) -> IsometryMatrix3<f64> {
        self.t_base_anchored.inverse() * t_base_flange * self.t_anchored_flange.inverse()
    }
}
