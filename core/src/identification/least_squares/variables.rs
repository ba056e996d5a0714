//! The variables of the least-squares problem, and their priors.

use crate::identification::model::correction_terms::Term;
use crate::identification::model::parameters::{Parameter, Quantity};
use crate::kinematics::Mounting;

/// Prior of a link's length as a share of the reach (one standard deviation): 0.5 mm on an arm of 1.7 m.
const LENGTH_PER_REACH: f64 = 0.5 / 1700.0;
/// Prior of an angle between two axes, rad (0.05°).
const ANGLE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Prior of a joint offset, rad (0.3°): joints are mastered on the shop floor.
const OFFSET_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// Prior of the position of a measured base frame, mm (one standard deviation): a frame that was set up with probes and sweeps.
pub const BASE_MM: f64 = 1.0;
/// Prior of the rotation of a measured base frame, rad (0.05°).
pub const BASE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;

/// Usual error of a link's length, mm. It is also the expected scatter of positions.
pub fn usual_length_mm(reach_mm: f64) -> f64 {
    LENGTH_PER_REACH * reach_mm
}

/// Usual error of an angle between two axes, rad.
pub const USUAL_ANGLE_RAD: f64 = ANGLE_RAD;

/// Usual error of a joint offset, rad.
pub const USUAL_OFFSET_RAD: f64 = OFFSET_RAD;

/// Length that converts a pose's angles to mm before its noise is known, mm/rad: the ratio of the usual errors of link lengths and angles.
pub fn usual_mm_per_rad(reach_mm: f64) -> f64 {
    usual_length_mm(reach_mm) / ANGLE_RAD
}

/// Minimum growth of the prior of a correction: practically zero.
const MIN_CORRECTION_GROWTH: f64 = 1e-3;

/// Minimum of σ as a share of the reach. It only keeps the numbers finite: it is far below the resolution of any file.
pub const MIN_SIGMA: f64 = 1e-12;

/// Kinds of variables. Variables of a kind have similar errors, and their priors are widened together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// a and d.
    Length,
    /// alpha and beta.
    Angle,
    /// theta_offset.
    Offset,
    /// Position of a measured base frame.
    BasePosition,
    /// Rotation of a measured base frame.
    BaseRotation,
    /// Compliance of joints about their axes.
    JointCompliance,
    /// Compliance of joints across their axes.
    BearingCompliance,
    /// Compliance of the base.
    BaseCompliance,
    /// Coupling of joints.
    Coupling,
    /// Masses of links.
    Mass,
    /// First moments of links.
    FirstMoment,
    /// Harmonics of joints.
    Harmonic,
}

/// All kinds, in the order of [`Evidence::prior_growth`](crate::identification::least_squares::evidence::Evidence::prior_growth).
pub const KINDS: [Kind; 12] = [
    Kind::Length,
    Kind::Angle,
    Kind::Offset,
    Kind::BasePosition,
    Kind::BaseRotation,
    Kind::JointCompliance,
    Kind::BearingCompliance,
    Kind::BaseCompliance,
    Kind::Coupling,
    Kind::Mass,
    Kind::FirstMoment,
    Kind::Harmonic,
];

impl Kind {
    /// Minimum of the factor by which the priors of this kind grow. Nominal links are never better than their usual errors; an effect that
    /// needs corrections may be absent.
    pub fn min_growth(self) -> f64 {
        match self {
            Self::Length | Self::Angle | Self::Offset | Self::BasePosition | Self::BaseRotation => {
                1.0
            }
            _ => MIN_CORRECTION_GROWTH,
        }
    }
}

/// Prior of a variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Normal about the reference. The standard deviation is one width at the start, and follows the deviations of all variables of its kind.
    OfKind(Kind),
    /// Normal about `mean` with the standard deviation `std`, both in units of the width; never widened.
    Stated {
        /// Expected coordinate.
        mean: f64,
        /// One standard deviation of the coordinate.
        std: f64,
    },
    /// No prior knowledge.
    Flat,
}

/// What a variable moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unknown {
    /// A parameter of base, links or targets.
    Parameter(Parameter),
    /// The instrument's station (from 0) against the stations that stay: its shift along an axis of the measuring frame (0 to 2), or its rotation
    /// about one (3 to 5) through the base's origin.
    Station(usize, usize),
    /// A term of the corrections.
    Correction(Term),
}

/// A variable of the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variable {
    /// What it moves.
    pub unknown: Unknown,
    /// Unit of the coordinate, mm or rad.
    pub width: f64,
    /// Its prior.
    pub prior: Prior,
}

/// A parameter with its own prior: links by their kind, base and targets flat.
pub fn variable(parameter: Parameter, reach_mm: f64) -> Variable {
    let (width, prior) = match parameter {
        Parameter::Link(_, Quantity::A | Quantity::D) => {
            (LENGTH_PER_REACH * reach_mm, Prior::OfKind(Kind::Length))
        }
        Parameter::Link(_, Quantity::Alpha | Quantity::Beta) => {
            (ANGLE_RAD, Prior::OfKind(Kind::Angle))
        }
        Parameter::Link(_, Quantity::ThetaOffset) => (OFFSET_RAD, Prior::OfKind(Kind::Offset)),
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => (1.0, Prior::Flat),
        Parameter::BaseTranslation(_) | Parameter::Target(..) => (reach_mm, Prior::Flat),
    };
    Variable {
        unknown: Unknown::Parameter(parameter),
        width,
        prior,
    }
}

/// A component of a station's motion, without a prior.
pub fn station_variable(station: usize, axis: usize, reach_mm: f64) -> Variable {
    Variable {
        unknown: Unknown::Station(station, axis),
        width: if axis < 3 { reach_mm } else { 1.0 },
        prior: Prior::Flat,
    }
}

/// Prior widths of corrections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorrectionWidths {
    /// The usual widths, whatever the points show. Points that are left out of a fit then have no influence on its priors.
    Usual,
    /// The widths of each kind follow from the points, like those of the links.
    ByEvidence,
}

/// A term of the corrections with its own prior.
pub fn correction_variable(
    term: Term,
    mounting: &Mounting,
    reach_mm: f64,
    widths: CorrectionWidths,
) -> Variable {
    let kind = match term {
        Term::Joint(_, 2) => Some(Kind::JointCompliance),
        Term::Joint(..) => Some(Kind::BearingCompliance),
        Term::Base(_) => Some(Kind::BaseCompliance),
        Term::Coupling(..) => Some(Kind::Coupling),
        Term::Mass(_) => Some(Kind::Mass),
        Term::FirstMoment(..) => Some(Kind::FirstMoment),
        Term::Harmonic(..) => Some(Kind::Harmonic),
        // The mounting states how well its direction is known.
        Term::Gravity(_) => None,
    };
    let usual = Prior::Stated {
        mean: 0.0,
        std: 1.0,
    };
    let kind = kind.filter(|_| widths == CorrectionWidths::ByEvidence);
    Variable {
        unknown: Unknown::Correction(term),
        width: term.prior(mounting, reach_mm),
        prior: kind.map_or(usual, Prior::OfKind),
    }
}
