//! What a quick check answers: plain data.

use crate::calibration::method::{After, CheckVerdict};

/// The smallest change of one kind that the poses find, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct DetectableChange {
    /// `theta_offset_3`, `base`, `target_0`.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// Found with the stated power; `None` where these poses do not show it.
    pub change: Option<f64>,
    /// How far that change moves the target at these poses, rms, mm.
    pub tool_mm: Option<f64>,
}

/// The cause that explains the points best, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct LikeliestCause {
    /// The parameter; several names with "or" between them where the poses cannot tell which.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// Now − then.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// The test of a quick check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckTest {
    /// Sum of squares of the whitened errors.
    pub statistic: f64,
    /// Equations less the numbers of base and targets that were placed.
    pub n_combinations: usize,
    /// Degrees of freedom of the noise.
    pub freedom: f64,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
    /// What the set's own uncertainty and noise let expect of a point, rms, mm.
    pub expected_rms_mm: f64,
}

/// Whether the released set still holds.
#[derive(Clone, Debug, PartialEq)]
pub struct QuickCheck {
    /// The verdict.
    pub verdict: CheckVerdict,
    /// Why, in one sentence.
    pub reason: String,
    /// What happened before, if somebody said so.
    pub after: Option<After>,
    /// Configurations that were measured.
    pub n_configurations: usize,
    /// Share of unchanged robots that are called changed.
    pub level: f64,
    /// Probability with which the stated changes are found.
    pub power: f64,
    /// rms of the set on the points, mm.
    pub rms_mm: f64,
    /// And on the points that were held out when it was identified, mm.
    pub verified_rms_mm: Option<f64>,
    /// The test; `None` where it cannot be made.
    pub test: Option<CheckTest>,
    /// What it could have seen; empty where there is no test.
    pub detectable: Vec<DetectableChange>,
    /// What changed, if it did: the likeliest cause first.
    pub likeliest: Vec<LikeliestCause>,
    /// What to measure next.
    pub next: String,
}

/// Warning that the released set no longer holds.
pub const CHECK_CHANGED: &str = "check_changed";
/// Warning that the poses cannot tell whether it holds.
pub const CHECK_CANNOT_TELL: &str = "check_cannot_tell";
