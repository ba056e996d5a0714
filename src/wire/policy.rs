//! Release policy of a robot.

use crate::wire::issue::{Checker, Invalid};
use crate::wire::names;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest tolerance, mm: calibration does not help a robot with larger errors.
const MAX_TOLERANCE_MM: f64 = 1_000.0;

/// How a figure is compared with the tolerance: the decision rules of ILAC-G8:09/2019 and JCGM 106:2012, which ISO/IEC 17025 asks to be stated.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum DecisionRule {
    /// The figure alone must be within the tolerance.
    SimpleAcceptance,
    /// The figure plus its expanded uncertainty (95 %) must be.
    #[default]
    GuardedAcceptance,
}

names!(DecisionRule {
    SimpleAcceptance = "simple_acceptance", GuardedAcceptance = "guarded_acceptance",
});

/// A robot's policy. Gates that always hold are not part of it: errors on verify points improved on nominal and on the active set, no session
/// in which the set was no better than nominal, an identity that is not contradicted, plausible changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyBody {
    /// Largest predicted uncertainty of the tool over the workspace, and largest rms on verify points, mm; none: no tolerance.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1000)]
    pub tolerance_mm: Option<f64>,
    /// How the rms on verify points is compared with it. A policy that an older version stored has `simple_acceptance`.
    #[serde(default)]
    pub decision_rule: DecisionRule,
    /// Another measuring session must have verified the set.
    #[serde(default)]
    pub independent_session_required: bool,
    /// The key that releases must not be the one that uploaded.
    #[serde(default)]
    pub second_person_required: bool,
}

impl PolicyBody {
    /// Checks that the tolerance is a length above zero.
    ///
    /// # Errors
    /// [`Invalid`] if it is not.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        if let Some(tolerance) = self
            .tolerance_mm
            .filter(|tolerance| !(*tolerance > 0.0 && *tolerance <= MAX_TOLERANCE_MM))
        {
            checker.note(
                "/tolerance_mm",
                "out_of_range",
                format!("{tolerance} is not above 0 and at most {MAX_TOLERANCE_MM} mm"),
            );
        }
        checker.finish("invalid_policy")
    }
}
