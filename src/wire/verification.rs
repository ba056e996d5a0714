//! Verification facts: what one job found about a parameter set. They are stored with the job.

use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};

/// How a session and a parameter set fit together, as [`crate::calibration`] tells it by its warnings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// About as it should.
    Fits,
    /// The set is far off: from a file that fits the robot, or from the points that it was identified from.
    SetFarOff,
    /// The file that was scored does not fit the robot: no evidence for or against any set.
    DoesNotFit,
}

impl Fit {
    /// As it is stored.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fits => "fits",
            Self::SetFarOff => "set_far_off",
            Self::DoesNotFit => "does_not_fit",
        }
    }
}

impl TryFrom<String> for Fit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        [Self::Fits, Self::SetFarOff, Self::DoesNotFit]
            .into_iter()
            .find(|fit| fit.as_str() == text)
            .ok_or_else(|| format!("unknown fit {text:?}"))
    }
}

/// What one job found.
#[derive(Clone, Debug, PartialEq)]
pub struct Verification {
    /// A job of kind `verify`; otherwise one that identified the set.
    pub is_session: bool,
    /// Points that were not fitted.
    pub n_points: usize,
    /// rms of the nominal robot on them, without points that every robot misses, mm; of the fitted points where none was held out.
    pub before_rms_mm: Option<f64>,
    /// rms of the set, likewise, mm.
    pub after_rms_mm: Option<f64>,
    /// The set is nearer than the nominal robot.
    pub is_better: bool,
    /// Whether the points fit the robot.
    pub fit: Fit,
    /// How strong it is as evidence for the set: whether the points were measured anew.
    pub evidence: Evidence,
    /// The points (of an identification those that were fitted) repeat an upload from before the last session that did not fit, or it could not
    /// be told: they are no sign that the robot is well.
    pub is_repeat: bool,
    /// The number of that session in the robot's counter, 0 for none. Where another one came meanwhile, nobody has compared with what was before
    /// that.
    pub check_seq: i64,
    /// The tool's largest predicted uncertainty over the workspace, mm, of an identification.
    pub uncertainty_mm: Option<f64>,
}
