//! Release policy of a robot.

use crate::wire::issue::{Checker, Invalid};
use crate::wire::names;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest tolerance, mm. Calibration cannot help a robot with larger errors.
const MAX_TOLERANCE_MM: f64 = 1_000.0;

names! {
    /// Decision rule: how a value is compared with the tolerance (ILAC-G8:09/2019, JCGM 106:2012). ISO/IEC 17025 requires that the decision rule is
    /// stated.
    #[derive(
        Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
    )]
    #[serde(rename_all = "snake_case")]
    #[value(rename_all = "snake_case")]
    pub enum DecisionRule {
        /// The value itself must be within the tolerance.
        SimpleAcceptance = "simple_acceptance",
        /// The value plus its expanded uncertainty (95 %) must be within the tolerance.
        #[default]
        GuardedAcceptance = "guarded_acceptance",
    }
}

/// Release policy of a robot. It contains only the gates that can be configured. These gates and others apply to every release: the errors on verify
/// points are smaller than those of the nominal robot and of the active set; there is no session in which the set was not better than nominal; the
/// identity of the robot is not contradicted; the changes of parameters are plausible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyBody {
    /// Upper limit of both the predicted uncertainty of the tool over the workspace and the rms error on verify points, mm. If it is absent, there is
    /// no tolerance.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1000)]
    pub tolerance_mm: Option<f64>,
    /// How the rms error on verify points is compared with the tolerance. A policy that an older version stored has `simple_acceptance`.
    #[serde(default)]
    pub decision_rule: DecisionRule,
    /// Whether another measuring session must have verified the set.
    #[serde(default)]
    pub independent_session_required: bool,
    /// Whether the key that releases must differ from the key that uploaded.
    #[serde(default)]
    pub second_person_required: bool,
}

impl PolicyBody {
    /// Checks that the tolerance is above zero and not too large.
    ///
    /// # Errors
    /// [`Invalid`] if the tolerance is out of range.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.above_zero("/tolerance_mm", self.tolerance_mm, MAX_TOLERANCE_MM, "mm");
        checker.finish("invalid_policy")
    }
}
