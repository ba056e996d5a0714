//! Cleans the numbers of a description: restores right angles that were rounded, and removes rounding errors of floats.

use crate::exchange::{Chain, origin_of, pose_of};
use std::f64::consts::FRAC_PI_2;

/// An angle that is closer than this to a multiple of 90° is replaced by that multiple, rad. Descriptions contain 1.57, 1.571 or 1.5708. No arm is
/// designed with an angle 0.1° off a right angle.
const RIGHT_ANGLE_RAD: f64 = 2e-3;
/// A number that is closer than this to a multiple of a thousandth is replaced by that multiple, mm or degrees, because sums of floats are wrong in
/// their last digits. An angle of this size moves a point 3 m from the joint by less than 1e-9 mm.
const NOISE: f64 = 1e-11;
const STEP: f64 = 1e-3;

/// Replaces rounded right angles in a chain by exact ones.
pub fn with_right_angles(chain: &Chain) -> Chain {
    let mut chain = chain.clone();
    for joint in &mut chain.joints {
        let mut origin = origin_of(&joint.t_parent_joint);
        let rounded = origin.rpy_rad.map(right_angle);
        if rounded != origin.rpy_rad {
            origin.rpy_rad = rounded;
            joint.t_parent_joint = pose_of(&origin);
        }
        if let Some(axis) = &mut joint.axis {
            let along = axis.map(f64::round);
            if along.norm() == 1.0 && (*axis - along).norm() < RIGHT_ANGLE_RAD {
                *axis = along;
            }
        }
    }
    chain
}

fn right_angle(rad: f64) -> f64 {
    let nearest = (rad / FRAC_PI_2).round() * FRAC_PI_2;
    if (rad - nearest).abs() < RIGHT_ANGLE_RAD {
        nearest
    } else {
        rad
    }
}

/// Removes the rounding error of a float. The result is never a negative zero.
pub fn clean(number: f64) -> f64 {
    let nearest = (number / STEP).round() / STEP.recip();
    let is_noise = (number - nearest).abs() < NOISE;
    (if is_noise { nearest } else { number }) + 0.0
}

#[cfg(test)]
mod tests {
    use super::{clean, right_angle};

    #[test]
    #[allow(clippy::approx_constant, reason = "files write the rounded number")]
    fn noise_goes_and_numbers_stay() {
        assert_eq!(clean(704.999_999_999_999_9), 705.0);
        assert_eq!(clean(163.941), 163.941);
        assert_eq!(clean(163.941_000_01), 163.941_000_01);
        assert!(clean(-0.0).is_sign_positive());
        assert_eq!(right_angle(-1.5708), -std::f64::consts::FRAC_PI_2);
        assert_eq!(right_angle(0.61), 0.61);
    }
}
