//! Rotation conventions: the meaning of three angles in a file.
//!
//! There are twenty-four sequences of elementary rotations, and rotation vectors. The convention is never guessed, because the same three numbers are
//! a valid rotation in all conventions.

use nalgebra::{Matrix3, Rotation3, Vector3};
use std::fmt;
use std::str::FromStr;

/// Meaning of three angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationConvention {
    /// Elementary rotations one after another.
    Sequence {
        /// The axes in the order of the rotations, 0 to 2 for x to z.
        axes: [usize; 3],
        /// True: rotations about the fixed axes. False: rotations about the axes of the already rotated frame (intrinsic).
        is_extrinsic: bool,
    },
    /// Rotation vector: axis times angle.
    RotationVector,
}

const AXES: [char; 3] = ['x', 'y', 'z'];
const ROTATION_VECTOR: &str = "rotation_vector";

impl RotationConvention {
    /// All conventions.
    pub fn all() -> Vec<Self> {
        let mut all = vec![Self::RotationVector];
        for is_extrinsic in [true, false] {
            for code in 0..27 {
                let axes = [code / 9, code / 3 % 3, code % 3];
                if axes[0] != axes[1] && axes[1] != axes[2] {
                    all.push(Self::Sequence { axes, is_extrinsic });
                }
            }
        }
        all.reverse();
        all
    }

    /// The rotation of three angles, rad. If the three axes are different, each angle belongs to the axis in its name (rx to x). Otherwise (proper
    /// Euler angles) the angles are in the order of the axes.
    pub fn rotation(self, angles_rad: &Vector3<f64>) -> Rotation3<f64> {
        let Self::Sequence { axes, is_extrinsic } = self else {
            return exp(angles_rad);
        };
        let is_proper_euler = axes[0] == axes[2];
        let turn = |k: usize| {
            let angle = match is_proper_euler {
                true => angles_rad[k],
                false => angles_rad[axes[k]],
            };
            about(axes[k], angle)
        };
        match is_extrinsic {
            true => turn(2) * turn(1) * turn(0),
            false => turn(0) * turn(1) * turn(2),
        }
    }
}

/// An elementary rotation about an axis of the frame.
fn about(axis: usize, angle_rad: f64) -> Rotation3<f64> {
    let (sin, cos) = libm::sincos(angle_rad);
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = Matrix3::identity();
    (m[(i, i)], m[(i, j)]) = (cos, -sin);
    (m[(j, i)], m[(j, j)]) = (sin, cos);
    Rotation3::from_matrix_unchecked(m)
}

fn exp(w: &Vector3<f64>) -> Rotation3<f64> {
    crate::kinematics::rotation::rotation_exp(w)
}

impl fmt::Display for RotationConvention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotationVector => f.write_str(ROTATION_VECTOR),
            Self::Sequence { axes, is_extrinsic } => {
                let kind = if *is_extrinsic {
                    "extrinsic"
                } else {
                    "intrinsic"
                };
                write!(
                    f,
                    "{kind}_{}{}{}",
                    AXES[axes[0]], AXES[axes[1]], AXES[axes[2]]
                )
            }
        }
    }
}

/// The text is not the name of a rotation convention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownConvention;

/// The possible names of conventions, for messages.
pub const CONVENTIONS: &str = "intrinsic_xyz, extrinsic_xyz, intrinsic_zyx, … (intrinsic or extrinsic, and any sequence of axes, also zyz and the \
                               like) or rotation_vector";

impl FromStr for RotationConvention {
    type Err = UnknownConvention;

    fn from_str(name: &str) -> Result<Self, UnknownConvention> {
        let known = Self::all().into_iter().find(|c| c.to_string() == name);
        known.ok_or(UnknownConvention)
    }
}
