//! Parts of stored reports, for what reads only a few of their fields. A report of 20,000 points has 9 MB.

use crate::wire::measurement::Warning;
use crate::wire::report_shape::{
    ChangeReport, FinalFitReport, ParameterReport, PointReport, SubsetReport, verify_errors_mm,
};
use serde::Deserialize;

/// What the history of a robot shows.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct HistoryExcerpt {
    /// Every free parameter.
    pub parameters: Vec<ParameterReport>,
    /// The held-out points.
    pub verify: Option<SubsetReport>,
    /// What changed.
    #[serde(default)]
    pub changed: Option<Vec<ChangeReport>>,
}

impl HistoryExcerpt {
    /// rms error of the held-out points, with corrections if there are any, mm.
    pub fn verify_rms_mm(&self) -> Option<f64> {
        self.verify
            .as_ref()
            .map(|verify| verify.corrected.unwrap_or(verify.after).rms_mm)
    }
}

/// What the gates of a release read; fields as in [`crate::wire::report_shape::Report`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ReleaseExcerpt {
    /// The fit to all points.
    #[serde(rename = "final", default)]
    pub final_fit: Option<FinalFitReport>,
    /// Every point.
    pub per_point: Vec<PointReport>,
    /// Every free parameter.
    pub parameters: Vec<ParameterReport>,
    /// Why there is no uncertainty.
    #[serde(default)]
    pub tool_uncertainty_absent_because: Option<String>,
    /// One standard deviation of the flange's rotation, degrees.
    #[serde(default)]
    pub flange_rotation_std_deg: Option<f64>,
    /// The part of it that is the zero of the last joint, degrees.
    #[serde(default)]
    pub last_joint_zero_std_deg: Option<f64>,
    /// Warnings.
    pub warnings: Vec<Warning>,
}

impl ReleaseExcerpt {
    /// Errors of each verify point: see [`verify_errors_mm`].
    pub fn verify_errors_mm(&self) -> Vec<[f64; 3]> {
        verify_errors_mm(&self.per_point)
    }
}
