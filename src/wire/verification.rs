//! Verification facts: what one job found about a parameter set. The facts are stored with the job.

pub use crate::calibration::Fit;
use crate::wire::names;
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};

names! {
    /// What a job did with a parameter set.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum VerificationKind {
        /// The job identified the set.
        Identification = "identification",
        /// The job scored the set on another session (kind `verify` or `check`).
        Session = "session",
    }
}

/// Verification facts of one job.
#[derive(Clone, Debug, PartialEq)]
pub struct Verification {
    /// Whether the job identified the set or scored it.
    pub kind: VerificationKind,
    /// Number of points that were not fitted.
    pub n_points: usize,
    /// rms error of the nominal robot on these points, without outliers, mm. If no point was held out, it is the rms error on the fitted points.
    pub before_rms_mm: Option<f64>,
    /// rms error of the parameter set on the same points, mm.
    pub after_rms_mm: Option<f64>,
    /// Expanded uncertainty of `after_rms_mm` (95 %), mm; none if it cannot be computed, or if an older version stored these facts.
    pub after_expanded_mm: Option<f64>,
    /// Whether the errors of the set are smaller than those of the nominal robot. In facts of older versions this is true for every session
    /// that is no evidence.
    pub is_better: bool,
    /// Whether the points fit the robot.
    pub fit: Fit,
    /// Strength of the evidence for the set: whether the points come from a new measurement.
    pub evidence: Evidence,
    /// Whether the points repeat an upload from before the last session that did not fit the robot, or whether this could not be decided. For an
    /// identification this refers to the fitted points. Repeated points are no evidence that the robot is in order.
    pub is_repeat: bool,
    /// Whether the errors of a session are several times larger than those on the points that were held out when the set was identified. Such a
    /// session is no evidence that the robot is in order again.
    pub is_worse: bool,
    /// Number in the audit chain of the upload in which the points appeared first; of several sessions, the newest of these. A copy is as old as what
    /// it copies. 0: unknown, as in facts of older versions.
    pub measured_seq: i64,
    /// Number of the last session that did not fit the robot, in the robot's counter; 0 for none. If yet another session does not fit before these
    /// facts are stored, the points count as a repeat, because they were not compared with the uploads from before that session.
    pub misfit_seq: i64,
    /// Largest predicted uncertainty of the tool over the workspace, mm; only for an identification.
    pub uncertainty_mm: Option<f64>,
}
