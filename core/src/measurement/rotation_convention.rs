//! Rotation conventions: the meaning of three angles in a file.
//!
//! There are twenty-four sequences of elementary rotations, and rotation vectors. The convention is never guessed, because the same three numbers are
//! a valid rotation in all conventions.

use crate::kinematics::rotation::{rotation_exp, rotation_log, within_half_a_turn};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};
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
/// Below this sine of the second angle (of the cosine, if the three axes differ), only the sum or difference of the other two angles is determined.
const GIMBAL_LOCK: f64 = 1e-9;

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
            return rotation_exp(angles_rad);
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

    /// The angles of a rotation, rad, in the order of [`Self::rotation`]. Several sets of angles give the same rotation; this returns the
    /// one nearest to `near_rad`. At a gimbal lock, the first angle stays as it is. (`euler_angles_ordered` of nalgebra returns one of two
    /// solutions regardless of the previous angles, and zero at a lock.)
    pub fn angles_rad(self, rotation: &Rotation3<f64>, near_rad: &Vector3<f64>) -> Vector3<f64> {
        let Self::Sequence { axes, is_extrinsic } = self else {
            return nearest_rotation_vector(rotation_log(rotation), near_rad);
        };
        // For rotations about fixed axes, the last rotation is the leftmost factor.
        let order = if is_extrinsic { [2, 1, 0] } else { [0, 1, 2] };
        let is_proper_euler = axes[0] == axes[2];
        let slots = order.map(|k| if is_proper_euler { k } else { axes[k] });
        let [i, j, k] = order.map(|k| axes[k]);
        let unit = |axis: usize| Vector3::ith(axis, 1.0);
        // R = R_i(a)·R_j(b)·R_k(c): R_i(−a)·R·e_k = R_j(b)·e_k has no component along j
        let v = rotation * unit(k);
        let across = unit(i).cross(&unit(j));
        let mut a = libm::atan2(-v[j], v.dot(&across));
        if libm::hypot(v[j], v.dot(&across)) < GIMBAL_LOCK {
            a = near_rad[slots[0]];
        } else if within_half_a_turn(a - near_rad[slots[0]]).abs() > FRAC_PI_2 {
            a += PI;
        }
        let rest = about(i, -a) * rotation;
        let (of_k, of_j) = (rest * unit(k), rest.inverse() * unit(j));
        let b = libm::atan2(of_k.dot(&unit(j).cross(&unit(k))), of_k[k]);
        let c = libm::atan2(-of_j.dot(&unit(k).cross(&unit(j))), of_j[j]);
        let mut angles_rad = Vector3::zeros();
        for (slot, angle_rad) in slots.into_iter().zip([a, b, c]) {
            let near_rad = near_rad[slot];
            angles_rad[slot] = near_rad + within_half_a_turn(angle_rad - near_rad);
        }
        angles_rad
    }
}

/// The rotation vector of the same rotation that is nearest to `near_rad`.
fn nearest_rotation_vector(vector_rad: Vector3<f64>, near_rad: &Vector3<f64>) -> Vector3<f64> {
    let other_rad = match vector_rad.norm() {
        0.0 => vector_rad,
        angle_rad => vector_rad * (1.0 - 2.0 * PI / angle_rad),
    };
    let distance = |vector: &Vector3<f64>| (vector - near_rad).norm();
    match distance(&other_rad) < distance(&vector_rad) {
        true => other_rad,
        false => vector_rad,
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

#[cfg(test)]
mod tests {
    use super::RotationConvention;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn angles_are_those_of_the_rotation_and_near_the_given_ones() {
        // The last two are gimbal locks: one with three different axes, and one with an axis that occurs twice.
        let angles_deg = [
            [10.0, 20.0, -30.0],
            [170.0, -100.0, 95.0],
            [-35.0, 90.0, 100.0],
            [-35.0, 0.0, 100.0],
        ];
        let turns =
            [0.0, 1e-4, 0.3].map(|angle| Rotation3::new(Vector3::new(0.3, -0.5, 0.8) * angle));
        for convention in RotationConvention::all() {
            for (angles_deg, turn) in angles_deg
                .iter()
                .flat_map(|a| turns.iter().map(move |t| (a, t)))
            {
                let near = Vector3::from(angles_deg.map(f64::to_radians));
                let wanted = turn * convention.rotation(&near);
                let found = convention.angles_rad(&wanted, &near);
                let off = (convention.rotation(&found).matrix() - wanted.matrix()).amax();
                assert!(off < 1e-12, "{convention} {angles_deg:?}: {off}");
                let away = (found - near).amax();
                assert!(away < 3.15, "{convention} {angles_deg:?}: {away}");
                // A rotation that does not change keeps its angles. Near a lock, they are kept only as far as the digits of the rotation
                // determine them.
                if turn == &turns[0] {
                    assert!(away < 1e-7, "{convention} {angles_deg:?}: {found:?}");
                }
            }
        }
    }
}
