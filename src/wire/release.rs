//! JSON types of releases: the gates, and the request body of a release.

use crate::wire::issue::{Checker, Invalid, Issue};
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A release gate and its result. It is stored with the release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Gate {
    /// Name of the gate.
    pub gate: String,
    /// Whether the gate passed.
    pub passed: bool,
    /// Description of the result.
    pub detail: String,
    /// True if the gate passed, but a person should look at its result.
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

    /// Sets `warning`, if the gate passed.
    pub fn with_warning(self, warning: bool) -> Self {
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

/// The gates of a parameter set and their results if it were released now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GatesAnswer {
    /// The parameter set.
    pub parameter_set_id: String,
    /// Whether all gates pass. If so, a release with the same key succeeds, unless something changes in the meantime.
    pub releasable: bool,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// Largest predicted uncertainty of the tool over the workspace, mm; absent if it cannot be computed.
    pub uncertainty_mm: Option<f64>,
    /// All gates. A gate with `warning` passed, but a person should look at its result.
    pub gates: Vec<Gate>,
}

/// Body of a release.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseBody {
    /// The reason.
    #[schema(min_length = 1, max_length = 2000)]
    pub reason: String,
    /// Why parameters changed by more than is plausible, e.g. `collision on Monday`. Required only if they did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 2000)]
    pub change_reason: Option<String>,
}

impl ReleaseBody {
    /// Checks the length of the reasons, and that they contain text.
    ///
    /// # Errors
    /// [`Invalid`] for a reason that is too long, or that contains no letter or digit.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.words("/reason", &self.reason, MAX_REASON);
        self.change_reason
            .iter()
            .for_each(|reason| checker.words("/change_reason", reason, MAX_REASON));
        checker.finish("invalid_reason")
    }
}

/// Maximum length of a reason, characters.
pub const MAX_REASON: usize = 2_000;

/// Reason of a withdrawal, a rollback or a `checked` request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReasonBody {
    /// The reason.
    #[schema(min_length = 1, max_length = 2000)]
    pub reason: String,
}

impl ReasonBody {
    /// Checks that the reason contains a letter or digit and has at most [`MAX_REASON`] characters.
    ///
    /// # Errors
    /// [`Invalid`] for a reason that is too long, or that contains no letter or digit.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.words("/reason", &self.reason, MAX_REASON);
        checker.finish("invalid_reason")
    }
}
