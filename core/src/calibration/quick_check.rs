//! Result of a quick check as plain data.

use crate::calibration::method::{After, CheckVerdict};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The smallest change of one parameter that a check detects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = DetectableReport)]
pub struct DetectableChange {
    /// The parameter: a joint zero (`theta_offset_3`), or a shift of `base` or `target_0` in the direction that is hardest to detect.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: String,
    /// Size of the change; null if these poses cannot show it, because base and targets are fitted again or because the target lies almost on the
    /// joint's axis.
    #[schema(required)]
    pub change: Option<f64>,
    /// rms displacement of the target by this change at these poses, mm.
    #[schema(required)]
    pub tool_mm: Option<f64>,
}

/// A possible cause of the change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = CauseReport)]
pub struct LikeliestCause {
    /// The parameter. Several names joined by "or" if the poses cannot tell these parameters apart.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: String,
    /// Change: current value − value in the parameter set.
    pub delta: f64,
    /// |delta| divided by its standard uncertainty.
    pub sigmas: f64,
}

/// The statistical test of a quick check. The errors of the points are whitened with the covariance that follows from the uncertainty and the noise
/// of the parameter set. The part that a new placement of base and targets can absorb is removed. The sum of squares divided by `n_combinations` is
/// compared with Fisher's F distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = CheckTestReport)]
pub struct CheckTest {
    /// Sum of squares of the whitened errors.
    pub statistic: f64,
    /// Number of equations minus the number of parameters of base and targets, which are fitted again.
    pub n_combinations: usize,
    /// Degrees of freedom of the noise estimate, which comes from the session of the parameter set.
    pub freedom: f64,
    /// p-value: probability that an unchanged robot gives at least this statistic.
    pub probability: f64,
    /// Expected 3-D rms error of a point for an unchanged robot, mm.
    pub expected_rms_mm: f64,
}

/// Result of a quick check: whether the released parameter set is still valid for the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = CheckReport)]
pub struct QuickCheck {
    /// The verdict. `changed` puts the robot into the state `check_robot`. `cannot_tell` is evidence neither for nor against a change.
    pub verdict: CheckVerdict,
    /// Reason for the verdict, in one sentence.
    pub reason: String,
    /// What happened to the robot before the check, as stated in the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<After>,
    /// Number of measured configurations.
    pub n_configurations: usize,
    /// Significance level of the test: share of unchanged robots for which it reports a change.
    pub level: f64,
    /// Power of the test: probability of detecting a change of the size stated in `detectable`.
    pub power: f64,
    /// rms error of the parameter set on the measured points, mm.
    pub rms_mm: f64,
    /// rms error of the parameter set on the points that were held out when it was identified, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verified_rms_mm: Option<f64>,
    /// The statistical test; null if there are too few data for it.
    #[schema(required)]
    pub test: Option<CheckTest>,
    /// The smallest single changes that the test detects with probability `power`; empty without a test.
    pub detectable: Vec<DetectableChange>,
    /// Possible causes of the change, the likeliest first; empty unless the verdict is `changed`.
    pub likeliest: Vec<LikeliestCause>,
    /// Recommended next measurement.
    pub next: String,
}

/// Warning: the released set is no longer valid.
pub const CHECK_CHANGED: &str = "check_changed";
/// Warning: the poses do not show whether the set is still valid.
pub const CHECK_CANNOT_TELL: &str = "check_cannot_tell";
/// Maximum number of changed parameters that count as an explanation.
pub const FEW_CAUSES: usize = 3;
