//! Reading the audit chain, and the entries that the rows of each table must have in it.

use serde_json::Value;
use sqlx::FromRow;
use sqlx::any::AnyRow;

use super::audit_chain::{AuditHead, AuditRow, HEAD};
use super::sql::{self, values};
use super::{AuditEvent, Result, Store};

/// Rows with entries in the audit chain. The same function computes an entry's content when it is written and when `verify-store` compares
/// it with the row.
pub(super) trait Audited: for<'r> FromRow<'r, AnyRow> + Send + Unpin {
    /// Query for the rows with an id above $1, ordered by id, at most $2.
    const BY_ID: &'static str;

    /// Subject of the entries: the row's id.
    fn subject(&self) -> &str;

    /// Expected content of the newest entry of each event about this row.
    fn expected_entries(&self) -> Vec<ExpectedEntry>;
}

#[derive(Debug)]
pub(super) struct ExpectedEntry {
    pub(super) event: AuditEvent,
    /// Time and fields; none if the event has not happened. The meaning of a field never changes, because old entries stay. New facts get
    /// new fields.
    pub(super) now: Option<(i64, Value)>,
    /// Field of the row that names the actor. Entries that are older than this field name the actor only as their own `actor`.
    pub(super) by: Option<&'static str>,
}

impl ExpectedEntry {
    pub(super) fn new(event: AuditEvent, now: Option<(i64, Value)>) -> Self {
        let by = None;
        Self { event, now, by }
    }

    pub(super) fn at(event: AuditEvent, at_ms: i64, detail: Value) -> Self {
        Self::new(event, Some((at_ms, detail)))
    }

    pub(super) fn by(self, field: &'static str) -> Self {
        let by = Some(field);
        Self { by, ..self }
    }
}

/// Implements [`Audited`] for a row, with the constant `BY_ID` of the calling file. The arguments are the row type, its field with the
/// subject, and its expected entries.
macro_rules! audited {
    ($row:ident, $($subject:ident).+, |$this:ident| $entries:expr) => {
        impl $crate::store::audit::Audited for $row {
            const BY_ID: &'static str = BY_ID;

            fn subject(&self) -> &str {
                &self.$($subject).+
            }

            fn expected_entries(&self) -> Vec<ExpectedEntry> {
                let $this = self;
                $entries
            }
        }
    };
}
pub(super) use audited;

pub(super) const ALL_QUERIES: &[&str] = &[LIST, ACTOR];

const LIST: &str = "
    select seq, at_ms, actor, event, subject, detail_json, sha256 from audit where seq > $1 order by seq limit cast($2 as bigint)";

const ACTOR: &str =
    "select actor from audit where subject = $1 and event = $2 order by seq limit 1";

/// The end of the chain.
pub async fn head(store: &Store) -> Result<AuditHead> {
    sql::one(store.readers(), HEAD, values![]).await
}

/// The entries after number `after`, in order, at most `limit`.
pub async fn list(store: &Store, after: i64, limit: i64) -> Result<Vec<AuditRow>> {
    sql::all(store.readers(), LIST, values![after, limit]).await
}

/// Actor of the first entry about this event and subject: usually the id of a key.
pub async fn actor(store: &Store, subject: &str, event: AuditEvent) -> Result<Option<String>> {
    let values = values![subject, event.as_str()];
    sql::first_value(store.readers(), ACTOR, values).await
}
