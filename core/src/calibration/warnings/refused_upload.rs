//! Advice about an upload that was refused and accepted by `insist`: always the advice of the refusal, whatever else its points show.

use crate::calibration::report::{NO_FIT, Warning};
use crate::calibration::warnings::plausibility::JOINT_MAP;

/// The correction that the refusal with this code requires.
pub fn remedy(code: &str) -> &'static str {
    match code {
        "frame_suspect" => {
            "upload it again in the frame that it was measured in (a tracker's own frame is the frame instrument)"
        }
        "unit_suspect" => "correct the units that the refusal named, and upload it again",
        "column_suspect" => "correct the columns that the refusal named, and upload it again",
        "joint_map_suspect" => {
            "correct the robot's joint_map as the refusal said, and upload it again"
        }
        "robot_mismatch" => "upload it to the robot that the refusal named",
        _ => {
            "see whether it is of this robot, and whether the joint values and the position of each row belong together"
        }
    }
}

/// The remedy in a sentence.
pub fn advice(code: &str) -> String {
    format!(
        "The upload was refused as {code}, and kept because the uploader insisted: {}",
        remedy(code)
    )
}

/// Extends a warning that nothing fits by the columns that are not read and may be the cause.
pub fn with_unread(told: Warning, unread: Option<&str>) -> Warning {
    match unread {
        Some(unread) if told.code == NO_FIT => Warning {
            detail: format!("{}. {unread}", told.detail),
            ..told
        },
        _ => told,
    }
}

/// Replaces the advice in a warning that the robot does not fit by the advice of the refusal.
pub fn advised(told: Warning, refused_as: Option<&str>) -> Warning {
    match refused_as {
        Some(code) if [NO_FIT, JOINT_MAP].contains(&told.code) && told.code != code => {
            let what = told.detail.split(':').next().unwrap_or_default();
            Warning {
                detail: format!("{what}. {}. It cannot be released", advice(code)),
                ..told
            }
        }
        _ => told,
    }
}

#[cfg(test)]
mod tests {
    use super::{JOINT_MAP, NO_FIT, with_unread};
    use crate::calibration::report::Warning;

    #[test]
    fn columns_that_are_not_read_are_named_where_nothing_fits() {
        let told = |code| {
            let told = Warning::new(code, "that is no fit");
            with_unread(told, Some("Not read: \"Target\"")).detail
        };
        assert_eq!(told(NO_FIT), "that is no fit. Not read: \"Target\"");
        assert_eq!(told(JOINT_MAP), "that is no fit");
    }
}
