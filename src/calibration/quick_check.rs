//! Result of a quick check as plain data.

use crate::calibration::method::{After, CheckVerdict};

/// The smallest change of one kind that the poses can detect, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct DetectableChange {
    /// `theta_offset_3`, `base`, `target_0`.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// Change that is detected with the stated power; `None` if these poses do not show it.
    pub change: Option<f64>,
    /// Displacement of the target by that change at these poses, rms, mm.
    pub tool_mm: Option<f64>,
}

/// The cause that explains the points best, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct LikeliestCause {
    /// The parameter; several names joined by "or" if the poses cannot tell them apart.
    pub name: String,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// New value minus old value.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// The test of a quick check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckTest {
    /// Sum of squares of the whitened errors.
    pub statistic: f64,
    /// Number of equations minus the fitted numbers of base and targets.
    pub n_combinations: usize,
    /// Degrees of freedom of the noise.
    pub freedom: f64,
    /// Probability that an unchanged robot gives at least this statistic.
    pub probability: f64,
    /// Expected error of a point from the set's own uncertainty and noise, rms, mm.
    pub expected_rms_mm: f64,
}

/// Whether the released set still holds.
#[derive(Clone, Debug, PartialEq)]
pub struct QuickCheck {
    /// The verdict.
    pub verdict: CheckVerdict,
    /// Why, in one sentence.
    pub reason: String,
    /// What happened to the robot before the check, if stated.
    pub after: Option<After>,
    /// Configurations that were measured.
    pub n_configurations: usize,
    /// False-alarm rate: share of unchanged robots that are called changed.
    pub level: f64,
    /// Probability with which the stated changes are detected.
    pub power: f64,
    /// Error of the released set on these points, rms, mm.
    pub rms_mm: f64,
    /// Error of the released set on the points held out at its identification, rms, mm.
    pub verified_rms_mm: Option<f64>,
    /// The test; `None` if it cannot be made.
    pub test: Option<CheckTest>,
    /// Smallest detectable changes; empty without a test.
    pub detectable: Vec<DetectableChange>,
    /// Possible causes if the robot has changed, the likeliest first.
    pub likeliest: Vec<LikeliestCause>,
    /// What to measure next.
    pub next: String,
}

/// Warning: the released set no longer holds.
pub const CHECK_CHANGED: &str = "check_changed";
/// Warning: the poses cannot tell whether the set holds.
pub const CHECK_CANNOT_TELL: &str = "check_cannot_tell";
