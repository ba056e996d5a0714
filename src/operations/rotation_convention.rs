//! Message for an upload with angles but without a rotation convention: the convention that fits best.

use crate::calibration::upload_checks::rotations::{OFF_RAD, best_convention};
use crate::measurement::RotationConvention;
use crate::measurement::columns::pose::ROTATION_REQUIRED;
use crate::wire::Invalid;
use crate::wire::measurement::{Upload, from_file};
use crate::wire::robot::Robot;

/// Adds the best-fitting rotation convention to the refusal of a file without one. The convention is never guessed: the user must state it.
pub fn with_best_convention(mut refusal: Invalid, robot: &Robot, upload: &Upload<'_>) -> Invalid {
    let missing = refusal.issues.iter_mut();
    let Some(issue) = missing.into_iter().find(|i| i.code == ROTATION_REQUIRED) else {
        return refusal;
    };
    // Any convention can be used for parsing, because the angles themselves are compared.
    let with_any = Upload {
        rotation: Some(RotationConvention::RotationVector),
        ..*upload
    };
    let read = from_file(&with_any, robot.links.len());
    if let Some(best) = read.ok().and_then(|(set, _)| best_convention(robot, &set)) {
        let degrees = best.most_rad.to_degrees();
        let told = match best.most_rad <= OFF_RAD {
            true => format!(
                "{} fits this robot best: four of five poses to {degrees:.2}°",
                best.name
            ),
            false => format!(
                "No convention fits this robot: the best, {}, leaves four of five poses within {degrees:.0}° only. Is it another robot, or does a camera on \
                 the arm see a fixed board (inverse_poses=true)?",
                best.name
            ),
        };
        issue.detail = format!("{}. {told}", issue.detail);
    }
    refusal
}
