//! Shapes of releases: the gates, and the body of a release.

use crate::wire::issue::{Checker, Invalid, Issue};
use crate::wire::reason::MAX_REASON;
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One gate and its result; stored with the release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Gate {
    /// Its name.
    pub gate: String,
    /// Whether it was passed.
    pub passed: bool,
    /// What was found.
    pub detail: String,
    /// True if it was passed, but somebody should look at it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warning: bool,
}

impl Gate {
    /// A gate and its result.
    pub fn new(gate: &str, passed: bool, detail: impl Into<String>) -> Self {
        Self {
            gate: gate.into(),
            passed,
            detail: detail.into(),
            warning: false,
        }
    }

    /// Sets `warning`: the gate passed, but somebody should look at it.
    pub fn warned(self, warning: bool) -> Self {
        Self {
            warning: warning && self.passed,
            ..self
        }
    }

    /// This gate as an issue of a refusal.
    pub fn issue(&self) -> Issue {
        Issue {
            code: self.gate.clone(),
            detail: self.detail.clone(),
            ..Issue::default()
        }
    }
}

/// The gates as a release would find them now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GatesAnswer {
    /// The set.
    pub parameter_set_id: String,
    /// Whether every gate is passed: then a release by the same key succeeds, unless something changes meanwhile.
    pub releasable: bool,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// The tool's largest predicted uncertainty over the workspace, mm; none if it cannot be stated.
    pub uncertainty_mm: Option<f64>,
    /// All gates. Those with `warning` passed, but somebody should look at them.
    pub gates: Vec<Gate>,
}

/// Body of a release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseBody {
    /// The reason.
    #[schema(min_length = 1, max_length = 2000)]
    pub reason: String,
    /// Why parameters changed by more than can be expected, e.g. `collision on Monday`; needed only then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 2000)]
    pub change_reason: Option<String>,
}

impl ReleaseBody {
    /// Checks the length of the reasons, and that they contain text.
    ///
    /// # Errors
    /// [`Invalid`] for an overlong one, or one without a letter or digit.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.words("/reason", &self.reason, MAX_REASON);
        self.change_reason
            .iter()
            .for_each(|reason| checker.words("/change_reason", reason, MAX_REASON));
        checker.finish("invalid_reason")
    }
}
