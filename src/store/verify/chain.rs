//! Check I8: reads the audit chain from its first entry. The other checks compare rows with the chain.

use std::collections::BTreeMap;

use super::check::{BATCH, Check, MAX_LISTED, Options};
use crate::store::audit_event::CREATION;
use crate::store::sql::{self, values};
use crate::store::{AuditEvent, AuditRow, Result, Store, audit, audit_chain, idempotency};

/// Content of the chain, by subject.
pub(super) struct Chain {
    pub(super) check: Check,
    /// Start of the chain; older rows have no entries.
    pub(super) begun_at_ms: i64,
    /// Entries about each subject, in order.
    pub(super) events: BTreeMap<String, Vec<Entry>>,
    /// For each Idempotency-Key, the hash of its newest answer. Key and value are the two hashes of [`idempotency::hashes`].
    pub(super) answers: BTreeMap<String, String>,
}

/// Content of one entry.
pub(super) struct Entry {
    pub(super) event: String,
    pub(super) actor: String,
    pub(super) detail: serde_json::Value,
}

/// SQL: everything whose creation has an entry.
macro_rules! created_rows {
    () => {
        "select id, created_at_ms from robot union all select id, created_at_ms from measurement_set
         union all select id, created_at_ms from named_document union all select id, created_at_ms from frames
         union all select id, created_at_ms from job
         union all select id, created_at_ms from network union all select id, created_at_ms from residual_network
         union all select id, created_at_ms from parameter_set
         union all select id, created_at_ms from api_key"
    };
}
pub(super) use created_rows;

/// Rows that were created after the chain began and have no entry.
pub(super) const MISSING: &str = concat!(
    "select id from (",
    created_rows!(),
    ") as things
     where created_at_ms > $1 and not exists (select 1 from audit where subject = id and event like $3)
     order by id limit cast($2 as bigint)"
);

impl Chain {
    /// The entries of one event about one subject.
    pub(super) fn entries<'a>(
        &'a self,
        subject: &str,
        event: AuditEvent,
    ) -> impl DoubleEndedIterator<Item = &'a Entry> {
        let entries = self.events.get(subject).map_or(&[][..], Vec::as_slice);
        entries
            .iter()
            .filter(move |entry| entry.event == event.as_str())
    }

    pub(super) fn newest(&self, subject: &str, event: AuditEvent) -> Option<&Entry> {
        self.entries(subject, event).next_back()
    }

    /// One field of the newest entry of this event.
    pub(super) fn field_of_newest(
        &self,
        subject: &str,
        event: AuditEvent,
        field: &str,
    ) -> Option<String> {
        self.newest(subject, event)?
            .detail
            .get(field)?
            .as_str()
            .map(str::to_owned)
    }

    /// Whether the chain has the creation of this subject. Then the chain also has everything that happened to the subject later.
    pub(super) fn was_created(&self, subject: &str) -> bool {
        self.events
            .get(subject)
            .is_some_and(|entries| entries.iter().any(|entry| entry.event.ends_with(CREATION)))
    }
}

pub(super) async fn read(store: &Store, options: &Options) -> Result<Chain> {
    let head = audit::head(store).await?;
    let mut check = Check::new(
        "I8",
        "the audit chain is intact: no entry was edited, deleted or moved",
    );
    let mut events: BTreeMap<String, Vec<_>> = BTreeMap::new();
    let mut answers = BTreeMap::new();
    let (mut seq, mut sha256) = (0, String::new());
    let mut missing_head = options.known_head.clone();
    loop {
        let rows = audit::list(store, seq, BATCH).await?;
        let Some(last) = rows.last().map(|row| row.seq) else {
            break;
        };
        for row in rows {
            check_entry(&mut check, &row, seq, &sha256);
            missing_head =
                missing_head.filter(|head| (head.seq, &head.sha256) != (row.seq, &row.sha256));
            (seq, sha256) = (row.seq, row.sha256.clone());
            let detail: serde_json::Value =
                serde_json::from_str(&row.detail_json).unwrap_or_default();
            if let Some((request, answer)) = idempotency::answer_hashes(&detail) {
                answers.insert(request, answer);
            }
            events.entry(row.subject).or_default().push(Entry {
                event: row.event,
                actor: row.actor,
                detail,
            });
        }
        debug_assert_eq!(seq, last);
    }
    // A server may have added entries in the meantime, so the head that was read first need not be the last entry.
    check.require(head.seq <= seq, || {
        format!(
            "the chain ends at entry {seq}, but its stored head is entry {}",
            head.seq
        )
    });
    check.require(head.seq != seq || head.sha256 == sha256, || {
        format!("entry {seq} does not match the stored head of the chain")
    });
    if let Some(head) = missing_head {
        check.add_violation(format!(
            "the known head, entry {}, is not in the chain",
            head.seq
        ));
    }
    let pattern = format!("%{CREATION}");
    let values = values![head.begun_at_ms, MAX_LISTED as i64, pattern];
    let missing: Vec<String> = sql::all_values(store.readers(), MISSING, values).await?;
    missing
        .into_iter()
        .for_each(|id| check.add_violation(format!("{id} has no entry about its creation")));
    Ok(Chain {
        check,
        begun_at_ms: head.begun_at_ms,
        events,
        answers,
    })
}

fn check_entry(check: &mut Check, row: &AuditRow, seq_before: i64, sha256_before: &str) {
    check.n_examined += 1;
    check.require(row.seq == seq_before + 1, || {
        format!("after entry {seq_before} comes entry {}", row.seq)
    });
    check.require(row.sha256 == audit_chain::hash(sha256_before, row), || {
        format!(
            "entry {} ({} {}) does not match its hash or the entry before it",
            row.seq, row.event, row.subject
        )
    });
}
