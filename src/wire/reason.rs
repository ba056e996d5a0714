//! Reasons of decisions.

use crate::wire::issue::{Checker, Invalid};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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
