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

/// The angle in degrees for a text in radians, with as few decimals as the digits of the text determine: 2.9671 is 170°. A text with fewer
/// than [`MIN_DECIMALS`] decimals is treated as if it had that number.
pub fn degrees_of_rad(text: &str) -> Option<f64> {
    let rad: f64 = text.parse().ok()?;
    let deg = rad.to_degrees();
    if text.contains(['e', 'E']) {
        return Some(deg);
    }
    let decimals = text
        .split_once('.')
        .map_or(0, |(_, decimals)| decimals.len());
    let decimals = decimals.clamp(MIN_DECIMALS, MAX_DECIMALS);
    let half_step_deg = (0.5 / power_of_ten(decimals)).to_degrees();
    let rounded = |n| (deg * power_of_ten(n)).round() / power_of_ten(n);
    let mut all = (0..=decimals).map(rounded);
    let found = all.find(|rounded| (rounded - deg).abs() <= half_step_deg);
    Some(found.unwrap_or(deg) + 0.0)
}

/// Minimum number of decimals of an angle in radians; one step is 0.6°.
const MIN_DECIMALS: usize = 2;
/// Maximum number of decimals; further ones are rounding of floats.
const MAX_DECIMALS: usize = 13;

fn power_of_ten(n: usize) -> f64 {
    (0..n).fold(1.0, |power, _| 10.0 * power)
}

/// Removes the rounding error of a float. The result is never a negative zero.
pub fn clean(number: f64) -> f64 {
    let nearest = (number / STEP).round() / STEP.recip();
    let is_noise = (number - nearest).abs() < NOISE;
    (if is_noise { nearest } else { number }) + 0.0
}

#[cfg(test)]
mod tests {
    use super::{clean, degrees_of_rad, right_angle};

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

    #[test]
    fn angles_have_the_decimals_that_the_digits_in_radians_determine() {
        for (rad, deg) in [
            ("2.9671", 170.0),
            ("-2.9671", -170.0),
            ("2.96705972839036", 170.0),
            ("6.28", 360.0),
            ("2.0647", 118.3),
            ("0", 0.0),
            ("1", 57.3),
        ] {
            assert_eq!(degrees_of_rad(rad), Some(deg), "{rad}");
        }
        // All digits of a text that are more than rounding are used.
        assert_eq!(degrees_of_rad("2.967100000"), Some(170.002_307_4));
        assert_eq!(degrees_of_rad("two"), None);
    }
}
