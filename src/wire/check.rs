//! The answer of a quick check, as part of a report.

pub use crate::calibration::CheckVerdict;
use crate::calibration::quick_check::{CheckTest, DetectableChange, LikeliestCause, QuickCheck};
use crate::wire::job::After;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Whether the released set still holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckReport {
    /// The verdict. `changed` puts the robot into the state `check_robot`; `cannot_tell` is no evidence.
    pub verdict: CheckVerdict,
    /// Why, in one sentence.
    pub reason: String,
    /// What happened before, as the request says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<After>,
    /// Configurations that were measured.
    pub n_configurations: usize,
    /// Share of unchanged robots that the test calls changed.
    pub level: f64,
    /// Probability with which it finds a change of the size stated in `detectable`.
    pub power: f64,
    /// rms of the set's errors on the points, mm.
    pub rms_mm: f64,
    /// rms of its errors on the points held out when it was identified, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verified_rms_mm: Option<f64>,
    /// The test; null if it cannot be made.
    #[schema(required)]
    pub test: Option<CheckTestReport>,
    /// The smallest changes that it finds with probability `power`, each alone; empty without a test.
    pub detectable: Vec<DetectableReport>,
    /// What changed, the likeliest cause first; empty unless the verdict is `changed`.
    pub likeliest: Vec<CauseReport>,
    /// What to measure next.
    pub next: String,
}

/// The test of a quick check: the errors of the points, whitened by what the set's own uncertainty and noise let expect, and without what placing base
/// and targets takes up. Their sum of squares over `n_combinations` is compared with Fisher's F.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckTestReport {
    /// Sum of squares.
    pub statistic: f64,
    /// Equations less the numbers of base and targets that were placed anew.
    pub n_combinations: usize,
    /// Degrees of freedom of the noise, of the set's own session.
    pub freedom: f64,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
    /// Error of a point that an unchanged robot is expected to show, 3-D, rms, mm.
    pub expected_rms_mm: f64,
}

/// The smallest change of one kind that a check finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DetectableReport {
    /// A joint's zero (`theta_offset_3`), or a shift of `base` or of `target_0` in the direction in which it shows least.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: String,
    /// The change; null if these poses do not show it: base and targets are placed anew, or the target hardly leaves the joint's axis.
    #[schema(required)]
    pub change: Option<f64>,
    /// How far that change moves the target at these poses, rms, mm.
    #[schema(required)]
    pub tool_mm: Option<f64>,
}

/// A cause that explains the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CauseReport {
    /// The parameter; several names with "or" between them if the poses cannot decide which.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: String,
    /// now − then.
    pub delta: f64,
    /// |delta| in units of its own uncertainty.
    pub sigmas: f64,
}

impl From<&QuickCheck> for CheckReport {
    fn from(core: &QuickCheck) -> Self {
        Self {
            verdict: core.verdict,
            reason: core.reason.clone(),
            after: core.after,
            n_configurations: core.n_configurations,
            level: core.level,
            power: core.power,
            rms_mm: core.rms_mm,
            verified_rms_mm: core.verified_rms_mm,
            test: core.test.map(Into::into),
            detectable: core.detectable.iter().map(Into::into).collect(),
            likeliest: core.likeliest.iter().map(Into::into).collect(),
            next: core.next.clone(),
        }
    }
}

impl From<CheckTest> for CheckTestReport {
    fn from(core: CheckTest) -> Self {
        Self {
            statistic: core.statistic,
            n_combinations: core.n_combinations,
            freedom: core.freedom,
            probability: core.probability,
            expected_rms_mm: core.expected_rms_mm,
        }
    }
}

impl From<&DetectableChange> for DetectableReport {
    fn from(core: &DetectableChange) -> Self {
        Self {
            name: core.name.clone(),
            unit: core.unit.into(),
            change: core.change,
            tool_mm: core.tool_mm,
        }
    }
}

impl From<&LikeliestCause> for CauseReport {
    fn from(core: &LikeliestCause) -> Self {
        Self {
            name: core.name.clone(),
            unit: core.unit.into(),
            delta: core.delta,
            sigmas: core.sigmas,
        }
    }
}
