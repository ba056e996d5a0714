//! Arms with the structure of Universal Robots, in the frames of the maker's description (`ur_description`).
//!
//! The description's first joint is in `base_link_inertia`. This is the Base of the teach pendant, and `base_link` rotated by 180° about z. The links
//! of a robot may begin in either frame: a table of the maker's Denavit-Hartenberg parameters begins in Base, an imported description in `base_link`.
//! The positions of the shoulder's axis and of the arm with all joints at 0 show which one it is.

use crate::exchange::chain::{Axis, Chain, ChainJoint};
use crate::exchange::origin::{Origin, pose_of};
use crate::exchange::transplant::{nominal_at_zero, placed};
use crate::kinematics::{Link, Robot};
use nalgebra::{IsometryMatrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Names of the joints' frames in the description.
pub const FRAMES: [&str; 6] = [
    "shoulder",
    "upper_arm",
    "forearm",
    "wrist_1",
    "wrist_2",
    "wrist_3",
];
/// Largest distance of axes from the structure, as a share of the arm's length. The maker's own calibration moves axes by 1 to 3 mm per
/// metre.
const SAME_PER_LENGTH: f64 = 0.01;
/// Largest angle of axes from the structure: 1°.
const SAME_RAD: f64 = PI / 180.0;

/// The frame in which the links of a robot begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UrBase {
    /// The robot's own Base, `base_link_inertia` of the description.
    Base,
    /// `base_link` of the description.
    BaseLink,
}

/// Why a robot cannot be described in this way.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotUr {
    /// The number of joints is different.
    #[error("it has {0} joints instead of 6")]
    JointCount(usize),
    /// The joints are coupled, which a description cannot express.
    #[error("its joints are coupled")]
    Coupled,
    /// An axis is somewhere else.
    #[error(
        "with all joints at 0, {0} is not where it is on these robots, neither from the robot's own Base nor from base_link"
    )]
    Structure(&'static str),
    /// The structure is the same, but the lengths are not those of any arm of the maker.
    #[error(
        "it is built like one of theirs, but {0} is none of their lengths: no arm of Universal Robots in kincal's library comes within 1 %"
    )]
    Lengths(String),
}

/// An arm in the maker's frames.
#[derive(Clone, Debug, PartialEq)]
pub struct UrArm {
    /// The joints, starting from `base_link_inertia`.
    pub chain: Chain,
    /// The frame in which the links begin.
    pub base: UrBase,
}

impl UrBase {
    /// The base of the links in `base_link_inertia`.
    pub fn t_inertia_links(self) -> IsometryMatrix3<f64> {
        pose_of(&Origin {
            xyz_mm: [0.0; 3],
            rpy_rad: [0.0, 0.0, if self == Self::Base { 0.0 } else { PI }],
        })
    }

    /// Name of the frame.
    pub fn name(self) -> &'static str {
        match self {
            Self::Base => "Base of the teach pendant (base_link_inertia)",
            Self::BaseLink => "base_link",
        }
    }
}

/// The identified robot in the frames of the description. `makers_arms` are the arms of Universal Robots, because other makers build arms with the
/// same structure.
///
/// # Errors
/// [`NotUr`] if the nominal robot does not have this structure, or if its links begin in another frame.
pub fn described(
    nominal: &Robot,
    identified: &[Link],
    makers_arms: &[Robot],
) -> Result<UrArm, NotUr> {
    let (base, lengths) = base_and_lengths(nominal)?;
    let is_of_maker = |arm: &Robot| base_and_lengths(arm).is_ok_and(|(_, of)| lengths.are(&of));
    if !makers_arms.iter().any(is_of_maker) {
        return Err(NotUr::Lengths(lengths.in_words()));
    }
    let chain = placed(
        &lengths.chain(),
        nominal,
        identified,
        &base.t_inertia_links(),
    );
    Ok(UrArm {
        chain: chain.ok_or(NotUr::Coupled)?,
        base,
    })
}

/// The frame in which the links begin, and the lengths, for a robot of this structure.
fn base_and_lengths(nominal: &Robot) -> Result<(UrBase, Lengths), NotUr> {
    if nominal.links.len() != FRAMES.len() {
        return Err(NotUr::JointCount(nominal.links.len()));
    }
    let (axes, t_links_flange) = nominal_at_zero(nominal).ok_or(NotUr::Coupled)?;
    let in_base = |base: UrBase| {
        let t = base.t_inertia_links();
        let axes: Vec<Axis> = axes
            .iter()
            .map(|axis| Axis {
                point_mm: (t * nalgebra::Point3::from(axis.point_mm)).coords,
                direction: t.rotation * axis.direction,
            })
            .collect();
        Ok((base, lengths(&axes, &(t * t_links_flange))?))
    };
    in_base(UrBase::Base).or_else(|_: NotUr| in_base(UrBase::BaseLink))
}

/// Lengths of the maker's table, mm.
struct Lengths {
    d1: f64,
    a2: f64,
    a3: f64,
    d4: f64,
    d5: f64,
    d6: f64,
}

impl Lengths {
    fn all_mm(&self) -> [f64; 6] {
        [self.d1, self.a2, self.a3, self.d4, self.d5, self.d6]
    }

    /// Tolerance of equal lengths, mm.
    fn same_mm(&self) -> f64 {
        SAME_PER_LENGTH * (self.d1.abs() + self.a2.abs() + self.a3.abs())
    }

    /// True if the lengths are those of the other arm.
    fn are(&self, other: &Self) -> bool {
        let mut pairs = self.all_mm().into_iter().zip(other.all_mm());
        pairs.all(|(a, b)| (a - b).abs() <= other.same_mm())
    }

    fn in_words(&self) -> String {
        let names = ["d1", "a2", "a3", "d4", "d5", "d6"];
        let words: Vec<String> = names
            .iter()
            .zip(self.all_mm())
            .map(|(name, mm)| format!("{name} {mm:.1} mm"))
            .collect();
        words.join(", ")
    }

    /// The nominal description.
    fn chain(&self) -> Chain {
        let Self {
            d1,
            a2,
            a3,
            d4,
            d5,
            d6,
        } = *self;
        let origins = [
            ([0.0, 0.0, d1], [0.0; 3]),
            ([0.0; 3], [FRAC_PI_2, 0.0, 0.0]),
            ([a2, 0.0, 0.0], [0.0; 3]),
            ([a3, 0.0, d4], [0.0; 3]),
            ([0.0, -d5, 0.0], [FRAC_PI_2, 0.0, 0.0]),
            ([0.0, d6, 0.0], [FRAC_PI_2, PI, PI]),
        ];
        let joint = |(name, (xyz_mm, rpy_rad)): (&&str, ([f64; 3], [f64; 3]))| ChainJoint {
            name: (*name).into(),
            t_parent_joint: pose_of(&Origin { xyz_mm, rpy_rad }),
            axis: Some(Vector3::z()),
            limits_rad: None,
        };
        Chain {
            joints: FRAMES.iter().zip(origins).map(joint).collect(),
        }
    }
}

/// The lengths from the axes in `base_link_inertia` with all joints at 0: axis 1 upright, the arm stretched out along −x, axes 2, 3, 4 and 6 along
/// −y, axis 5 pointing down.
fn lengths(axes: &[Axis], t_inertia_flange: &IsometryMatrix3<f64>) -> Result<Lengths, NotUr> {
    const NAMES: [&str; 6] = ["axis 1", "axis 2", "axis 3", "axis 4", "axis 5", "axis 6"];
    let expected = [
        Vector3::z(),
        -Vector3::y(),
        -Vector3::y(),
        -Vector3::y(),
        -Vector3::z(),
        -Vector3::y(),
    ];
    for ((axis, expected), name) in axes.iter().zip(expected).zip(NAMES) {
        if axis.direction.cross(&expected).norm() > libm::sin(SAME_RAD)
            || axis.direction.dot(&expected) < 0.0
        {
            return Err(NotUr::Structure(name));
        }
    }
    // Horizontal axes are evaluated where they pass axis 1, upright axes at the height of the shoulder.
    let at = |axis: &Axis, along: usize, value: f64| {
        axis.point_mm + axis.direction * ((value - axis.point_mm[along]) / axis.direction[along])
    };
    let [two, three, four] = [1, 2, 3].map(|i| at(&axes[i], 1, 0.0));
    let d1 = two.z;
    let one = at(&axes[0], 2, 0.0);
    let five = at(&axes[4], 2, d1);
    let six = at(&axes[5], 1, five.y);
    let flange = t_inertia_flange.translation.vector;
    let lengths = Lengths {
        d1,
        a2: three.x,
        a3: four.x - three.x,
        d4: -five.y,
        d5: d1 - six.z,
        d6: five.y - flange.y,
    };
    let same = lengths.same_mm();
    let are = |all: &[f64]| all.iter().all(|mm| mm.abs() <= same);
    let places = [
        (are(&[one.x, one.y]), NAMES[0]),
        (are(&[two.x]) && lengths.d1 > same, NAMES[1]),
        (are(&[three.z - d1]) && lengths.a2 < -same, NAMES[2]),
        (are(&[four.z - d1]) && lengths.a3 < -same, NAMES[3]),
        (are(&[five.x - four.x]) && lengths.d4 > same, NAMES[4]),
        (are(&[six.x - five.x]) && lengths.d5 > same, NAMES[5]),
        (lengths.d6 > same, "the flange"),
    ];
    match places.iter().find(|(is_there, _)| !is_there) {
        Some((_, name)) => Err(NotUr::Structure(name)),
        None => Ok(lengths),
    }
}
