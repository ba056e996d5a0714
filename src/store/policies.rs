//! What robots ask of a release. A robot without a row asks nothing beyond the gates that always stand.

use serde_json::json;

use super::{Result, Store, Tx};

/// What one robot asks of a release.
#[derive(Clone, Debug, Default, PartialEq, sqlx::FromRow)]
pub struct PolicyRow {
    /// Largest uncertainty of the tool's position, and largest rms on verify points, mm.
    pub tolerance_mm: Option<f64>,
    /// 1: another measuring session must have verified the set.
    pub independent_session_required: i64,
    /// 1: who releases must not be who uploaded.
    pub second_person_required: i64,
    /// Counts the changes; 0 where nothing was ever set.
    pub version: i64,
}

/// Stands for a number that is not there. `Any` binds an absent double as a float4, which PostgreSQL then refuses where a statement was
/// prepared for the other of the two.
pub(super) const ABSENT: f64 = -1.0;

pub(super) const ALL_QUERIES: &[&str] = &[GET, PUT];

const GET: &str = "
    select tolerance_mm, independent_session_required, second_person_required, version from robot_policy where robot_id = $1";

const PUT: &str = "
    insert into robot_policy (robot_id, tolerance_mm, independent_session_required, second_person_required, version, changed_by, changed_at_ms)
    values ($1, nullif($2, cast(-1 as double precision)), $3, $4, 1, $5, (select now_ms from clock))
    on conflict (robot_id) do update set tolerance_mm = excluded.tolerance_mm,
        independent_session_required = excluded.independent_session_required, second_person_required = excluded.second_person_required,
        version = robot_policy.version + 1, changed_by = excluded.changed_by, changed_at_ms = excluded.changed_at_ms
    returning tolerance_mm, independent_session_required, second_person_required, version";

/// A robot's policy.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn get(store: &Store, robot_id: &str) -> Result<PolicyRow> {
    let row: Option<PolicyRow> = sqlx::query_as(GET).bind(robot_id).fetch_optional(store.pool()).await?;
    Ok(row.unwrap_or_default())
}

pub(super) async fn get_in(tx: &mut Tx, robot_id: &str) -> Result<PolicyRow> {
    let row: Option<PolicyRow> = sqlx::query_as(GET).bind(robot_id).fetch_optional(tx.connection()?).await?;
    Ok(row.unwrap_or_default())
}

/// Sets a robot's policy; its version counts up.
///
/// # Errors
/// [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn put(tx: &mut Tx, robot_id: &str, policy: &PolicyRow, by: &str) -> Result<PolicyRow> {
    let query = sqlx::query_as(PUT).bind(robot_id).bind(policy.tolerance_mm.unwrap_or(ABSENT));
    let query = query.bind(policy.independent_session_required).bind(policy.second_person_required).bind(by);
    let row: PolicyRow = query.fetch_one(tx.connection()?).await?;
    let detail = json!({"tolerance_mm": row.tolerance_mm, "independent_session_required": row.independent_session_required == 1,
        "second_person_required": row.second_person_required == 1, "version": row.version});
    tx.note("robot_policy_changed", robot_id, &detail);
    Ok(row)
}
