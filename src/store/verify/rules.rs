//! Of I1: who may do what, and what robots ask of a release, are as the newest entry in the chain says.

use std::collections::BTreeSet;

use serde_json::json;

use super::Check;
use super::chain::Chain;
use crate::store::policies::ABSENT;
use crate::store::{Result, Store};

pub(super) const POLICIES: &str = "
    select robot_id, coalesce(tolerance_mm, cast(-1 as double precision)), independent_session_required, second_person_required, version,
        changed_at_ms
    from robot_policy order by robot_id";
pub(super) const KEYS: &str = "
    select id, name, key_sha256, scopes_json, robots_json, cast(case when revoked_at_ms is null then 0 else 1 end as bigint) from api_key order by id";

type PolicyFound = (String, f64, i64, i64, i64, i64);
type KeyFound = (String, String, String, String, Option<String>, i64);

/// Keys and policies are rows that may change, each time with an entry.
pub(super) async fn are_as_noted(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    policies(check, store, chain).await?;
    keys(check, store, chain).await
}

async fn policies(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    let rows: Vec<PolicyFound> = sqlx::query_as(POLICIES).fetch_all(store.pool()).await?;
    let mut found = BTreeSet::new();
    for (robot_id, tolerance_mm, independent, second, version, changed_at_ms) in rows {
        check.n_examined += 1;
        let tolerance_mm = (tolerance_mm != ABSENT).then_some(tolerance_mm);
        let now = json!({"tolerance_mm": tolerance_mm, "independent_session_required": independent == 1,
            "second_person_required": second == 1, "version": version});
        let is_noted = match chain.details(&robot_id, "robot_policy_changed").last() {
            Some(then) => *then == now,
            None => changed_at_ms <= chain.begun_at_ms,
        };
        check.require(is_noted, || format!("{robot_id}: its policy is not the one that was set last"));
        found.insert(robot_id);
    }
    for id in chain.events.keys() {
        let was_set = chain.details(id, "robot_policy_changed").next().is_some();
        check.require(!was_set || found.contains(id), || format!("{id}: its policy was acknowledged and is gone"));
    }
    Ok(())
}

async fn keys(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    let rows: Vec<KeyFound> = sqlx::query_as(KEYS).fetch_all(store.pool()).await?;
    for (id, name, key_sha256, scopes, robots, is_revoked) in rows {
        check.n_examined += 1;
        let Some(then) = chain.details(&id, "key_created").last() else { continue };
        let now = json!({"name": name, "scopes": scopes, "robots": robots, "key_sha256": key_sha256});
        // Older entries lack some of the fields.
        let differs = now.as_object().into_iter().flatten().find(|(field, now)| then.get(*field).is_some_and(|then| then != *now));
        check.require(differs.is_none(), || {
            format!("{id}: its {} is not what it was made with", differs.map_or("", |(field, _)| field.as_str()))
        });
        let was_revoked = chain.details(&id, "key_revoked").next().is_some();
        check.require(was_revoked == (is_revoked == 1), || match was_revoked {
            true => format!("{id}: it was revoked and is in force"),
            false => format!("{id}: it is revoked, and no entry says so"),
        });
    }
    Ok(())
}
