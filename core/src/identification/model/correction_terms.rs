//! The terms of the corrections ([`crate::kinematics::compliance`]): the numbers that are identified, with their priors.

use crate::kinematics::{Corrections, Mounting};
use nalgebra::{Unit, Vector3};
use serde::{Deserialize, Serialize};

/// One term of the corrections. All terms are 0 for a robot without corrections. Joints, links, axes and orders count from 0, also in stored
/// estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Term {
    /// Compliance of a joint (0-based) about an axis of its frame, rad per unit moment.
    Joint(usize, usize),
    /// Compliance of the base about an axis of its frame, rad per unit moment.
    Base(usize),
    /// Mass of a link beyond [`usual_masses`](crate::kinematics::corrections::usual_masses).
    Mass(usize),
    /// First moment of a link along an axis of its frame, mass × metres.
    FirstMoment(usize, usize),
    /// Tilt of gravity against the mounting's direction, along one of two axes across it, rad.
    Gravity(usize),
    /// Coupling: the angle by which the first joint turns per angle of the second, rad/rad. For the same joint, the error of its gear ratio.
    Coupling(usize, usize),
    /// Amplitude of a joint's harmonic: joint, order (from 0), and 0 for the sine, 1 for the cosine; rad.
    Harmonic(usize, usize, usize),
}

/// Prior of a joint's compliance about its own axis, one standard deviation: rotation by a unit mass at the end of the reach, rad. This is 1 mrad per
/// metre for an arm of 1.7 m.
const PRIOR_JOINT_RAD: f64 = 1.7e-3;
/// The same across the joint's axis: bearings are stiffer than gears.
const PRIOR_ACROSS_RAD: f64 = 0.85e-3;
/// The same for the base.
const PRIOR_BASE_RAD: f64 = 0.51e-3;
/// Prior of a link's mass beyond its usual mass, one standard deviation.
const PRIOR_MASS: f64 = 0.2;
/// Prior of a link's first moment, as a share of the reach: a mass of `PRIOR_MASS` at a quarter of a metre from its frame's origin, on an arm of 1.7
/// m.
const PRIOR_FIRST_MOMENT: f64 = 0.05 / 1.7;
/// Prior of a coupling, rad/rad: 0.3 mrad, or 0.017°, per radian.
const PRIOR_COUPLING: f64 = 3e-4;
/// Prior of a harmonic's amplitude, rad (0.01°): the usual eccentricity of gears and encoders.
const PRIOR_HARMONIC_RAD: f64 = 2e-4;

impl Term {
    /// Prior standard deviation of the term for an arm of this reach.
    pub fn prior(&self, mounting: &Mounting, reach_mm: f64) -> f64 {
        let reach_m = 1e-3 * reach_mm.max(f64::MIN_POSITIVE);
        match self {
            Self::Joint(_, 2) => PRIOR_JOINT_RAD / reach_m,
            Self::Joint(..) => PRIOR_ACROSS_RAD / reach_m,
            Self::Base(_) => PRIOR_BASE_RAD / reach_m,
            // A direction that is stated as exact may change only by rounding.
            Self::Gravity(_) => mounting.std_rad.max(1e-9),
            Self::Mass(_) => PRIOR_MASS,
            Self::FirstMoment(..) => PRIOR_FIRST_MOMENT * reach_m,
            Self::Coupling(..) => PRIOR_COUPLING,
            Self::Harmonic(..) => PRIOR_HARMONIC_RAD,
        }
    }
}

/// Two axes perpendicular to the mounting's gravity.
pub fn across_gravity(mounting: &Mounting) -> [Vector3<f64>; 2] {
    let g = &mounting.gravity_in_base;
    let first = g.cross(&Vector3::ith(g.iamin(), 1.0)).normalize();
    [first, g.cross(&first)]
}

/// The corrections at the given values of the terms.
pub fn corrections_at(
    n_links: usize,
    mounting: &Mounting,
    terms: &[Term],
    values: &[f64],
) -> Corrections {
    let mut corrections = Corrections::none(n_links, mounting);
    let axes = across_gravity(mounting);
    let mut gravity = mounting.gravity_in_base;
    let compliance = &mut corrections.compliance;
    for (term, value) in terms.iter().zip(values) {
        match *term {
            Term::Joint(joint, axis) => compliance.joints_rad[joint][axis] += value,
            Term::Base(axis) => compliance.base_rad[axis] += value,
            Term::Mass(link) => compliance.masses[link] += value,
            Term::FirstMoment(link, axis) => compliance.first_moments_m[link][axis] += value,
            Term::Gravity(axis) => gravity += axes[axis] * *value,
            Term::Coupling(joint, followed) => {
                corrections.joint_coupling[joint][followed] += value;
            }
            Term::Harmonic(joint, order, 0) => corrections.harmonics[joint][order].sin_rad += value,
            Term::Harmonic(joint, order, _) => corrections.harmonics[joint][order].cos_rad += value,
        }
    }
    compliance.gravity_in_base = Unit::new_normalize(gravity).into_inner();
    corrections
}
