//! The row of a parameter set, and the content of the audit entries about it.

use super::from_row::row;
use super::listing::list_row;
use crate::wire::canonical;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::Evidence;
use serde_json::{Value, json};

row! {
    /// A parameter set.
    #[derive(Clone, Debug, PartialEq)]
    pub struct ParameterSetRow {
        /// `par_…`
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// The job that identified it.
        pub job_id: String,
        /// Its state.
        pub status: ParameterSetStatus,
        /// The parameters in JSON.
        pub body_json: String,
        /// SHA-256 of the parameters, hexadecimal.
        pub sha256: String,
        /// When it was stored.
        pub created_at_ms: i64,
        /// When it was last released.
        pub released_at_ms: Option<i64>,
        /// Reason of its last release.
        pub release_reason: Option<String>,
        /// Gates of its last release, in JSON.
        pub release_checks_json: Option<String>,
        /// Number of gates that passed.
        pub release_n_passed: Option<i64>,
        /// Number of gates that failed.
        pub release_n_failed: Option<i64>,
        /// When it was withdrawn.
        pub withdrawn_at_ms: Option<i64>,
        /// Reason of the withdrawal.
        pub withdraw_reason: Option<String>,
        /// Who last released it.
        pub released_by: Option<String>,
        /// Name of the key that last released it.
        pub released_by_name: Option<String>,
        /// Who withdrew it.
        pub withdrawn_by: Option<String>,
        /// Name of the key that withdrew it.
        pub withdrawn_by_name: Option<String>,
        /// Strength of the verification behind its last release.
        pub release_evidence: Option<Evidence>,
        /// The tool's largest uncertainty over the workspace at its last release, mm.
        pub release_uncertainty_mm: Option<f64>,
        /// Number of its last release. All releases of a robot are numbered by one counter.
        pub release_seq: Option<i64>,
        /// The set that its last release superseded.
        pub supersedes_id: Option<String>,
        /// When it was archived.
        pub archived_at_ms: Option<i64>,
        /// When its job was archived.
        pub job_archived_at_ms: Option<i64>,
        /// Version of the robot that the set was identified with.
        pub robot_version: i64,
        /// Version of the robot's joint map that the set was identified with.
        pub joint_map_version: i64,
    }
}

list_row!(ParameterSetRow);

/// Content of the audit entry about its creation.
pub(super) fn created_detail(row: &ParameterSetRow) -> Value {
    json!({"robot_id": row.robot_id, "job_id": row.job_id, "sha256": row.sha256, "created_at_ms": row.created_at_ms,
        "body_sha256": canonical::sha256_hex(row.body_json.as_bytes())})
}

/// Content of the audit entry about its last release, and the time of the release.
pub(super) fn released_detail(row: &ParameterSetRow) -> Option<(i64, Value)> {
    // A release writes all of these columns. If only some are set, an edit outside the service wrote them. Then the time is 0, and the comparison
    // with the audit chain fails.
    let is_set = row.release_reason.is_some() || row.released_by.is_some();
    let is_set = is_set || row.release_evidence.is_some() || row.release_uncertainty_mm.is_some();
    let at_ms = row.released_at_ms.or(is_set.then_some(0))?;
    let checks_sha256 = row
        .release_checks_json
        .as_ref()
        .map(|checks| canonical::sha256_hex(checks.as_bytes()));
    let detail = json!({"reason": row.release_reason, "sha256": row.sha256, "checks_sha256": checks_sha256, "evidence": row.release_evidence.map(Evidence::as_str),
        "uncertainty_mm": row.release_uncertainty_mm, "released_by": row.released_by, "released_at_ms": row.released_at_ms,
        "n_passed": row.release_n_passed, "n_failed": row.release_n_failed, "release_seq": row.release_seq, "supersedes_id": row.supersedes_id});
    Some((at_ms, detail))
}

/// Content of the audit entry about its withdrawal, and the time of the withdrawal.
pub(super) fn withdrawn_detail(row: &ParameterSetRow) -> Option<(i64, Value)> {
    let is_set = row.withdraw_reason.is_some() || row.withdrawn_by.is_some();
    let at_ms = row.withdrawn_at_ms.or(is_set.then_some(0))?;
    let detail = json!({"reason": row.withdraw_reason, "withdrawn_by": row.withdrawn_by, "withdrawn_at_ms": row.withdrawn_at_ms});
    Some((at_ms, detail))
}
