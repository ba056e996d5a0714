//! Verification facts: what one job found about a parameter set. They are stored with the job.

pub use crate::calibration::Fit;
use crate::wire::names;
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};

/// What a job did with the set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VerificationKind {
    /// It identified the set.
    Identification,
    /// It scored the set on another session: a job of kind `verify`.
    Session,
}

names!(VerificationKind { Identification = "identification", Session = "session" });

/// Verification facts of one job.
#[derive(Clone, Debug, PartialEq)]
pub struct Verification {
    /// Whether the job identified the set or scored it.
    pub kind: VerificationKind,
    /// Number of points that were not fitted.
    pub n_points: usize,
    /// rms of the nominal robot on them, without outliers, mm. If no point was held out, it is that of the fitted points.
    pub before_rms_mm: Option<f64>,
    /// rms of the set on the same points, mm.
    pub after_rms_mm: Option<f64>,
    /// Expanded uncertainty of `after_rms_mm` (95 %), mm; none if it cannot be stated, or if an older version found this.
    pub after_expanded_mm: Option<f64>,
    /// Whether the set's errors are smaller than the nominal robot's.
    pub is_better: bool,
    /// Whether the points fit the robot.
    pub fit: Fit,
    /// Strength as evidence for the set: whether the points were measured anew.
    pub evidence: Evidence,
    /// Whether the points repeat an upload from before the last session that did not fit, or this could not be decided. For an identification the
    /// fitted points count. Repeated points do not show that the robot is in order.
    pub is_repeat: bool,
    /// Whether a session's errors are several times those on the points that were held out when the set was identified. Such a session does not show
    /// that the robot is in order again.
    pub is_worse: bool,
    /// Number of that session in the robot's counter; 0 for none. If a later session does not fit either before the facts are stored, the points
    /// count as a repeat, because they were not compared with the uploads from before the later session.
    pub check_seq: i64,
    /// The tool's largest predicted uncertainty over the workspace, mm; only of an identification.
    pub uncertainty_mm: Option<f64>,
}
