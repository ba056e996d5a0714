//! How well the measured positions determine the flange's orientation, from the standard deviations and the warnings of a report.

use crate::calibration::{MAX_FLANGE_ROTATION_STD_RAD, ORIENTATION_NOT_KNOWN};
use crate::wire::warning::Warning;

/// Warning that the positions hardly determine the flange's orientation.
pub(super) const POSE_NOT_SEEN: &str = "pose_not_seen";

/// Texts for the orientations of these names.
pub(super) const NOT_COMPUTED: &str =
    "the uncertainty of the flange's rotation could not be computed";
pub(super) const NOT_COMPUTED_BY_OLDER_VERSION: &str = "the measured positions hardly show how the flange is turned, and the version that \
    identified this set did not compute its uncertainty";

/// Whether the orientation of the flange is known, and why not. Standard deviations are in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Orientation {
    Known,
    /// Only the zero of the last joint is unknown. It turns the tool about the last axis, and is no sign of an error in the other links.
    LastJointZeroUnknown {
        std_deg: f64,
    },
    /// `links_std_deg` is the part of `std_deg` that does not come from the zero of the last joint.
    NotShown {
        std_deg: f64,
        links_std_deg: f64,
    },
    NotComputed,
    /// The positions hardly determine the orientation, and the older version that wrote the report computed no standard deviation.
    NotComputedByOlderVersion,
}

impl Orientation {
    /// From these fields of a report.
    pub(super) fn new(
        flange_rotation_std_deg: Option<f64>,
        last_joint_zero_std_deg: Option<f64>,
        warnings: &[Warning],
    ) -> Self {
        let has_warning = |code: &str| warnings.iter().any(|warning| warning.code == code);
        let most_deg = MAX_FLANGE_ROTATION_STD_RAD.to_degrees();
        let Some(std_deg) = flange_rotation_std_deg else {
            return if has_warning(ORIENTATION_NOT_KNOWN) {
                Self::NotComputed
            } else if has_warning(POSE_NOT_SEEN) {
                Self::NotComputedByOlderVersion
            } else {
                Self::Known
            };
        };
        let zero_deg = last_joint_zero_std_deg.unwrap_or(0.0);
        let links_std_deg = (std_deg * std_deg - zero_deg * zero_deg).max(0.0).sqrt();
        if links_std_deg > most_deg {
            Self::NotShown {
                std_deg,
                links_std_deg,
            }
        } else if std_deg > most_deg {
            Self::LastJointZeroUnknown { std_deg }
        } else {
            Self::Known
        }
    }
}
