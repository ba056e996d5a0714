//! A joint that follows another one: gears of a wrist that the controller does not compensate. No link parameter describes it.

use crate::calibration::report::Warning;
use crate::identification::statistics::uncertainty::Uncertainty;
use std::f64::consts::PI;

/// Warning of each joint that follows another one.
pub fn warnings(uncertainty: &Uncertainty) -> impl Iterator<Item = Warning> {
    let followings = uncertainty.features.followings.iter();
    followings.enumerate().map(|(k, following)| {
        let row = uncertainty.n_parameters + k;
        // the feature is the followed joint's value in half turns
        let share = uncertainty.mean(row) / PI;
        let (percent, std_percent) = (100.0 * share, 100.0 * uncertainty.posterior_std(row) / PI);
        let (joint, followed) = (following.joint + 1, following.followed + 1);
        Warning::new("joint_follows", format!(
                "joint {joint} turns by {percent:+.2} % (± {std_percent:.2} %, one standard deviation of the noise alone) of the value of joint {followed} in addition to its own: by the points, the gears \
                 between them are not compensated. If that may be, add {share:+.5} times row {followed} to row {joint} of joint_map.coupling (the identity, if none is \
                 stated) and calibrate again"
            ))
    })
}
