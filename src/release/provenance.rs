//! Where a parameter set comes from, and what follows for its use.

use crate::wire::measurement::Frame;
use crate::wire::parameter_set::Provenance;
use crate::wire::report_shape::WRONG_ROBOT;
use crate::wire::report_summary::ReportSummary;

/// Provenance of the parameters that a report is about, with the warnings that its users should see.
pub fn provenance(report: ReportSummary, measuring_frame: Option<Frame>) -> Provenance {
    let mut warnings = report.warnings;
    warnings.retain(|warning| {
        warning.code == "pose_not_seen" || WRONG_ROBOT.contains(&warning.code.as_str())
    });
    Provenance {
        measuring_frame,
        flange_rotation_std_deg: report.flange_rotation_std_deg,
        last_joint_zero_std_deg: report.last_joint_zero_std_deg,
        warnings,
    }
}
