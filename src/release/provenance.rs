//! Where a parameter set comes from, and what follows for its use.

use crate::calibration::{
    MAX_FLANGE_ROTATION_STD_RAD, ORIENTATION_NOT_KNOWN, last_joint_zero_remedy,
    last_joint_zero_unknown,
};
use crate::release::verdict::WRONG_ROBOT;
use crate::wire::angle::to_degrees;
use crate::wire::measurement::Frame;
use crate::wire::parameter_set::Provenance;
use crate::wire::report_summary::ReportSummary;

/// Warning of older versions that the positions do not show how the flange is turned.
const POSE_NOT_SEEN: &str = "pose_not_seen";

/// Provenance of the parameters that a report is about, with the warnings that its users should see.
pub fn provenance(report: ReportSummary, measuring_frame: Option<Frame>) -> Provenance {
    let mut warnings = report.warnings;
    warnings.retain(|warning| {
        let code = warning.code.as_str();
        [POSE_NOT_SEEN, ORIENTATION_NOT_KNOWN].contains(&code) || WRONG_ROBOT.contains(&code)
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

/// Reason why the flange's rotation is unknown for a robot of so many links; `None` if it is known. Reports of older versions have only a warning
/// for it.
pub fn orientation_unknown(provenance: &Provenance, n_links: usize) -> Option<String> {
    let remedy =
        "identify from a reflector off the last axis, or from two, at poses that move every joint";
    let most = to_degrees(MAX_FLANGE_ROTATION_STD_RAD);
    let last_zero = provenance.last_joint_zero_std_deg;
    match provenance.flange_rotation_std_deg {
        Some(std) if std > most && shown_by_positions(std, last_zero) <= most => Some(format!(
            "{}. {}",
            last_joint_zero_unknown(std, n_links),
            last_joint_zero_remedy(n_links)
        )),
        Some(std) if std > most => Some(format!(
            "the measured positions do not show how the flange is turned: it may be off by {std:.2}°, one standard deviation: {remedy}"
        )),
        None if provenance.warnings.iter().any(|w| w.code == POSE_NOT_SEEN) => Some(format!(
            "the measured positions hardly show how the flange is turned, and by how much it may be off was not computed by the version \
                 that identified this set: identify it again, or {remedy}"
        )),
        None if provenance
            .warnings
            .iter()
            .any(|w| w.code == ORIENTATION_NOT_KNOWN) =>
        {
            Some(format!(
                "by how much the flange may be turned could not be computed: {remedy}"
            ))
        }
        _ => None,
    }
}

/// One standard deviation of the flange's rotation without the zero of the last joint, degrees.
pub fn shown_by_positions(
    flange_rotation_std_deg: f64,
    last_joint_zero_std_deg: Option<f64>,
) -> f64 {
    let zero = last_joint_zero_std_deg.unwrap_or(0.0);
    (flange_rotation_std_deg * flange_rotation_std_deg - zero * zero)
        .max(0.0)
        .sqrt()
}
