//! Origin of a parameter set, and the restrictions on its use.

use crate::calibration::{
    INSTRUMENT_SCALE, ORIENTATION_NOT_KNOWN, last_joint_zero_remedy, last_joint_zero_unknown,
};
use crate::release::orientation::{
    NOT_COMPUTED, NOT_COMPUTED_BY_OLDER_VERSION, Orientation, POSE_NOT_SEEN,
};
use crate::release::verdict::{INSISTED, WRONG_ROBOT};
use crate::wire::measurement::Frame;
use crate::wire::parameter_set::Provenance;
use crate::wire::report_summary::ReportSummary;

/// Provenance of the parameters that a report is about, with the warnings that its users should see.
pub fn provenance(report: ReportSummary, measuring_frame: Option<Frame>) -> Provenance {
    let mut warnings = report.warnings;
    warnings.retain(|warning| {
        let code = warning.code.as_str();
        [
            POSE_NOT_SEEN,
            ORIENTATION_NOT_KNOWN,
            INSTRUMENT_SCALE,
            INSISTED,
        ]
        .contains(&code)
            || WRONG_ROBOT.contains(&code)
    });
    Provenance {
        measuring_frame,
        flange_rotation_std_deg: report.flange_rotation_std_deg,
        last_joint_zero_std_deg: report.last_joint_zero_std_deg,
        warnings,
    }
}

/// Code and text of the warning because of which the set must not correct targets, if there is one.
pub fn wrong_robot(provenance: &Provenance) -> Option<(&'static str, &str)> {
    WRONG_ROBOT.into_iter().find_map(|code| {
        let mut warnings = provenance.warnings.iter();
        let warning = warnings.find(|warning| warning.code == code)?;
        Some((code, warning.detail.as_str()))
    })
}

/// Reason why the flange's rotation is unknown, for a robot with `n_links` links; `None` if it is known.
pub fn orientation_unknown(provenance: &Provenance, n_links: usize) -> Option<String> {
    let remedy =
        "identify from a reflector off the last axis, or from two, at poses that move every joint";
    let orientation = Orientation::new(
        provenance.flange_rotation_std_deg,
        provenance.last_joint_zero_std_deg,
        &provenance.warnings,
    );
    Some(match orientation {
        Orientation::Known => return None,
        Orientation::LastJointZeroUnknown { std_deg } => format!(
            "{}. {}",
            last_joint_zero_unknown(std_deg, n_links),
            last_joint_zero_remedy(n_links)
        ),
        Orientation::NotShown { std_deg, .. } => format!(
            "the measured positions do not show how the flange is turned: it may be off by {std_deg:.2}°, one standard deviation: {remedy}"
        ),
        Orientation::NotComputed => {
            format!("{NOT_COMPUTED}: {remedy}")
        }
        Orientation::NotComputedByOlderVersion => {
            format!("{NOT_COMPUTED_BY_OLDER_VERSION}: identify it again, or {remedy}")
        }
    })
}
