//! Release policies of robots. For a robot without a policy row, a release is checked only against the gates that apply to every robot.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::sql::{self, values};
use super::{AuditEvent, Result, Store, Tx, robots};
use crate::wire::policy::{DecisionRule, PolicyBody};

row! {
    /// Release policy of a robot.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct PolicyRow {
        /// Largest uncertainty of the tool's position, and largest rms on verify points, mm.
        pub tolerance_mm: Option<f64>,
        /// How the rms is compared with the tolerance; none in a policy that an older version stored.
        pub decision_rule: Option<DecisionRule>,
        /// Whether another measuring session must have verified the set.
        pub independent_session_required: bool,
        /// Whether the key that releases must differ from the key that uploaded.
        pub second_person_required: bool,
        /// Number of changes; 0 if never set.
        pub version: i64,
    }
}

/// Value that is bound in place of an absent double. sqlx's `Any` binds an absent double as float4, which PostgreSQL refuses if the statement was
/// prepared with float8.
pub(super) const ABSENT: f64 = -1.0;

pub(super) const ALL_QUERIES: &[&str] = &[GET, PUT, BY_ID];

const GET: &str = "
    select tolerance_mm, decision_rule, independent_session_required, second_person_required, version from robot_policy where robot_id = $1";

const PUT: &str = "
    insert into robot_policy (robot_id, tolerance_mm, independent_session_required, second_person_required, version, changed_by, changed_at_ms,
        decision_rule)
    values ($1, nullif($2, cast(-1 as double precision)), $3, $4, 1, $5, (select now_ms from clock), $6)
    on conflict (robot_id) do update set tolerance_mm = excluded.tolerance_mm,
        independent_session_required = excluded.independent_session_required, second_person_required = excluded.second_person_required,
        version = robot_policy.version + 1, changed_by = excluded.changed_by, changed_at_ms = excluded.changed_at_ms,
        decision_rule = excluded.decision_rule
    returning robot_id, tolerance_mm, decision_rule, independent_session_required, second_person_required, version, changed_by, changed_at_ms";

const BY_ID: &str = "
    select robot_id, tolerance_mm, decision_rule, independent_session_required, second_person_required, version, changed_by, changed_at_ms
    from robot_policy where robot_id > $1 order by robot_id limit cast($2 as bigint)";

row! {
    /// A policy with its robot and the key that set it.
    #[derive(Debug)]
    pub(super) struct PolicyChange {
        robot_id: String,
        policy: PolicyRow,
        changed_by: String,
        changed_at_ms: i64,
    }
}

fn changed_detail(set: &PolicyChange) -> Value {
    let PolicyChange {
        policy,
        changed_by,
        changed_at_ms,
        ..
    } = set;
    let mut entry = json!({"tolerance_mm": policy.tolerance_mm, "independent_session_required": policy.independent_session_required,
        "second_person_required": policy.second_person_required, "version": policy.version,
        "changed_by": changed_by, "changed_at_ms": changed_at_ms});
    // Audit entries of older versions do not have this field.
    if let Some(rule) = policy.decision_rule {
        entry["decision_rule"] = json!(rule.as_str());
    }
    entry
}

audited!(PolicyChange, robot_id, |row| vec![
    ExpectedEntry::at(
        AuditEvent::RobotPolicyChanged,
        row.changed_at_ms,
        changed_detail(row)
    )
    .by("changed_by")
]);

/// A robot's policy.
pub async fn get(store: &Store, robot_id: &str) -> Result<PolicyRow> {
    let row: Option<_> = sql::first(store.readers(), GET, values![robot_id]).await?;
    Ok(row.unwrap_or_default())
}

pub(super) async fn get_in(tx: &mut Tx, robot_id: &str) -> Result<PolicyRow> {
    let row: Option<_> = sql::first(tx.connection(), GET, values![robot_id]).await?;
    Ok(row.unwrap_or_default())
}

/// Sets a robot's policy and increments its version.
///
/// # Errors
/// [`super::Conflict::RobotArchived`], [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn put(tx: &mut Tx, robot_id: &str, policy: &PolicyBody, by: &str) -> Result<PolicyRow> {
    // The lock waits until a release of this robot that is under way has ended. A later release sees the new policy.
    robots::lock_in_use(tx, robot_id).await?;
    let values = values![
        robot_id,
        policy.tolerance_mm.unwrap_or(ABSENT),
        i64::from(policy.independent_session_required),
        i64::from(policy.second_person_required),
        by,
        policy.decision_rule.as_str()
    ];
    let set: PolicyChange = sql::one(tx.connection(), PUT, values).await?;
    tx.audit(
        AuditEvent::RobotPolicyChanged,
        robot_id,
        changed_detail(&set),
    );
    Ok(set.policy)
}
