//! One promise of the store, and its violations.

use crate::store::AuditEntryId;

/// A promise and the result of its check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// `I1` to `I9`.
    pub id: &'static str,
    /// Text of the promise.
    pub promise: &'static str,
    /// Number of rows that were examined.
    pub n_examined: i64,
    /// Violations, at most [`MAX_LISTED`].
    pub violations: Vec<String>,
    /// Number of all violations.
    pub n_violations: i64,
}

/// Maximum number of listed violations; further ones are only counted.
pub const MAX_LISTED: usize = 100;
/// Number of small rows read at a time.
pub(super) const BATCH: i64 = 200;
/// Number of uploads, networks and reports read at a time. One, because a single document may have 45 MB.
pub(super) const DOCUMENT_BATCH: i64 = 1;

/// Options of the checks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// A head of the audit chain that was stored elsewhere.
    pub known_head: Option<AuditEntryId>,
    /// Whether a server is running. If so, a lease that expired long ago is a violation.
    pub is_served: bool,
}

impl Check {
    pub(super) fn new(id: &'static str, promise: &'static str) -> Self {
        Check {
            id,
            promise,
            n_examined: 0,
            violations: Vec::new(),
            n_violations: 0,
        }
    }

    pub(super) fn add_violation(&mut self, what: String) {
        self.n_violations += 1;
        if self.violations.len() < MAX_LISTED {
            self.violations.push(what);
        }
    }

    pub(super) fn require(&mut self, is_kept: bool, what: impl FnOnce() -> String) {
        if !is_kept {
            self.add_violation(what());
        }
    }
}
