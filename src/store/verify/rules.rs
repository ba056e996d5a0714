//! Part of I1: compares the fields of rows with the newest audit entries about them.

use std::collections::BTreeSet;

use super::chain::Chain;
use super::check::{BATCH, Check};
use crate::store::audit::{Audited, ExpectedEntry};
use crate::store::jobs::JobWithClient;
use crate::store::parameter_sets::ParameterSetRow;
use crate::store::policies::PolicyChange;
use crate::store::{
    ApiKeyRow, ArchivedRow, AuditEvent, FramesRow, MeasurementSetRow, NamedDocumentRow, NetworkRow,
    ParameterSetStatus, Result, RobotRow, Store, VerificationRow, robot_versions, sql,
};
use crate::wire::canonical;

/// The events that change the status of a parameter set, with the status after the event.
const STATUS_AFTER_EVENT: &[(AuditEvent, ParameterSetStatus)] = &[
    (
        AuditEvent::ParameterSetCreated,
        ParameterSetStatus::Candidate,
    ),
    (
        AuditEvent::ParameterSetReleased,
        ParameterSetStatus::Released,
    ),
    (
        AuditEvent::ParameterSetSuperseded,
        ParameterSetStatus::Superseded,
    ),
    (
        AuditEvent::ParameterSetWithdrawn,
        ParameterSetStatus::Withdrawn,
    ),
];

/// Compares every kind of row that has entries in the chain.
pub(super) async fn match_entries(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    for_each_row(check, store, chain, |check, row| robot(check, chain, row)).await?;
    robot_versions(check, store, chain).await?;
    for_each_row(check, store, chain, |_, _: &MeasurementSetRow| ()).await?;
    for_each_row(check, store, chain, |_, _: &NamedDocumentRow| ()).await?;
    for_each_row(check, store, chain, |_, _: &FramesRow| ()).await?;
    for_each_row(check, store, chain, |_, _: &JobWithClient| ()).await?;
    for_each_row(check, store, chain, |_, _: &NetworkRow| ()).await?;
    for_each_row(check, store, chain, |_, _: &ApiKeyRow| ()).await?;
    for_each_row(check, store, chain, |check, row| {
        parameter_set(check, chain, row)
    })
    .await?;
    let (mut policies, mut verifications) = (BTreeSet::new(), BTreeSet::new());
    for_each_row(check, store, chain, |_, row: &PolicyChange| {
        policies.insert(row.subject().to_owned());
    })
    .await?;
    for_each_row(check, store, chain, |_, row: &VerificationRow| {
        verifications.insert(row.subject().to_owned());
    })
    .await?;
    let mut archived = BTreeSet::new();
    for_each_row(check, store, chain, |_, row: &ArchivedRow| {
        archived.insert(row.subject().to_owned());
    })
    .await?;
    for id in chain.events.keys() {
        check.require(was_archived(chain, id) == archived.contains(id), || {
            format!("{id}: its archived state is not what the audit chain says")
        });
        for (event, found, what) in [
            (AuditEvent::RobotPolicyChanged, &policies, "its policy"),
            (
                AuditEvent::VerificationKept,
                &verifications,
                "what it found",
            ),
        ] {
            let was_stored = chain.newest(id, event).is_some();
            check.require(!was_stored || found.contains(id), || {
                format!("{id}: {what} was acknowledged and is gone")
            });
        }
    }
    Ok(())
}

/// Whether the newest entry about archiving says that this item is archived.
fn was_archived(chain: &Chain, id: &str) -> bool {
    let entries = chain.events.get(id).map_or(&[][..], Vec::as_slice);
    let mut about = entries.iter().rev().filter_map(|entry| {
        [(AuditEvent::Archived, true), (AuditEvent::Restored, false)]
            .into_iter()
            .find(|(event, _)| event.as_str() == entry.event)
    });
    about.next().is_some_and(|(_, is_archived)| is_archived)
}

/// Checks that each version of a robot matches the audit entry of its edit, and that the version of each such entry exists.
async fn robot_versions(check: &mut Check, store: &Store, chain: &Chain) -> Result<()> {
    let mut found = BTreeSet::new();
    let mut after = (String::new(), 0);
    loop {
        let rows = robot_versions::after(store, &after.0, after.1, BATCH).await?;
        let Some(last) = rows.last() else { break };
        after = (last.robot_id.clone(), last.version);
        for row in rows {
            check.n_examined += 1;
            let mut entries = chain.entries(&row.robot_id, AuditEvent::RobotEdited);
            let then = entries.find(|entry| entry.detail["version"] == row.version);
            let now = robot_versions::edited_detail(&row);
            let is_so = then.is_some_and(|then| {
                let mut fields = now.as_object().into_iter().flatten();
                fields.all(|(field, now)| then.detail.get(field) == Some(now))
            });
            check.require(is_so, || {
                format!(
                    "{}: its version {} is not what the audit chain says",
                    row.robot_id, row.version
                )
            });
            found.insert((row.robot_id.clone(), row.version));
        }
    }
    for id in chain.events.keys() {
        for entry in chain.entries(id, AuditEvent::RobotEdited) {
            let version = entry.detail["version"].as_i64().unwrap_or_default();
            check.require(found.contains(&(id.clone(), version)), || {
                format!("{id}: its version {version} was acknowledged and is gone")
            });
        }
    }
    Ok(())
}

/// Compares all rows of one kind with their audit entries, and calls `further` for each row.
async fn for_each_row<T: Audited>(
    check: &mut Check,
    store: &Store,
    chain: &Chain,
    mut further: impl FnMut(&mut Check, &T),
) -> Result<()> {
    let examine = |row: T| {
        check.n_examined += 1;
        row.expected_entries()
            .iter()
            .for_each(|entry| compare(check, chain, row.subject(), entry));
        further(check, &row);
    };
    sql::for_each_row(store.readers(), T::BY_ID, BATCH, T::subject, examine).await
}

/// Compares a row's fields with an audit entry. Fields that the entry does not have are skipped, because older entries lack some fields.
fn compare(check: &mut Check, chain: &Chain, id: &str, expected: &ExpectedEntry) {
    let ExpectedEntry { event, now, by } = expected;
    match (chain.newest(id, *event), now) {
        (Some(then), Some((_, now))) => {
            for (field, now) in now.as_object().into_iter().flatten() {
                let is_so = match then.detail.get(field) {
                    Some(then) => then == now,
                    None => *by != Some(field.as_str()) || *now == *then.actor,
                };
                check.require(is_so, || {
                    format!("{id}: its {field} is not what {event} says in the audit chain")
                });
            }
        }
        (Some(_), None) => check.add_violation(format!(
            "{id}: {event} is in the audit chain, but not in its row"
        )),
        // I8 reports creations without an entry.
        (None, Some((at_ms, _))) if !event.is_creation() => {
            let is_older = *at_ms <= chain.begun_at_ms && !chain.was_created(id);
            check.require(is_older, || {
                format!("{id}: {event} is not in the audit chain")
            });
        }
        (None, _) => {}
    }
}

/// Checks that the robot is in the state `check_robot` exactly if the newest audit entry about this state says so.
fn robot(check: &mut Check, chain: &Chain, row: &RobotRow) {
    let about = [
        AuditEvent::RobotDoesNotFit,
        AuditEvent::RobotFitsAgain,
        AuditEvent::RobotChecked,
    ];
    let entries = chain.events.get(&row.id).map_or(&[][..], Vec::as_slice);
    let newest = entries
        .iter()
        .rev()
        .find(|entry| about.iter().any(|event| event.as_str() == entry.event));
    let asks = newest
        .filter(|entry| entry.event == AuditEvent::RobotDoesNotFit.as_str())
        .and_then(|entry| entry.detail["job_id"].as_str());
    let last = chain.newest(&row.id, AuditEvent::RobotDoesNotFit);
    let seq = last.map_or(Some(0), |last| last.detail["check_seq"].as_i64());
    let is_so = asks == row.check_job_id.as_deref() && seq == Some(row.misfit_seq);
    check.require(is_so, || {
        format!(
            "{}: its state check_robot is not what the audit chain says",
            row.id
        )
    });
}

fn parameter_set(check: &mut Check, chain: &Chain, row: &ParameterSetRow) {
    let content: Option<serde_json::Value> = serde_json::from_str(&row.body_json).ok();
    let text = content.and_then(|content| {
        canonical::text_with_hash(&content, &row.sha256)
            .ok()
            .flatten()
    });
    check.require(text.is_some(), || {
        format!("{}: its content does not match its hash", row.id)
    });
    let entries = chain.events.get(&row.id).map_or(&[][..], Vec::as_slice);
    let then = entries.iter().rev().find_map(|entry| {
        STATUS_AFTER_EVENT
            .iter()
            .find(|(event, _)| event.as_str() == entry.event)
    });
    if let Some((_, then)) = then {
        check.require(*then == row.status, || {
            format!(
                "{} is {}, the audit chain says {}",
                row.id,
                row.status.as_str(),
                then.as_str()
            )
        });
    }
}
