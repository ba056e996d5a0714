//! The audit chain: every creation, release, withdrawal, end of a job and change of a key, in the transaction that did it.
//! Each entry's hash covers its content and the hash before it, so that an edit, a deletion or another order shows.
//!
//! Whoever can write to the database can also compute a new chain from the edit on. Against that, keep a head elsewhere now
//! and then (`kincal verify-store` prints it) and have it looked for later (`--known-head`).

use serde_json::Value;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, FromRow};

use super::{Result, Store};
use crate::wire::canonical;

/// One entry of the chain.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct AuditRow {
    /// 1, 2, 3, ….
    pub seq: i64,
    /// When, by the database's clock.
    pub at_ms: i64,
    /// The id of the key, `worker`, `command line`, ….
    pub actor: String,
    /// `robot_created`, `parameter_set_released`, ….
    pub event: String,
    /// The id of what it is about.
    pub subject: String,
    /// What else is worth keeping: hashes, reasons.
    pub detail_json: String,
    /// Of this entry and the one before, hexadecimal.
    pub sha256: String,
}

/// The chain's newest entry; 0 and empty before the first.
#[derive(Clone, Debug, Default, PartialEq, Eq, sqlx::FromRow)]
pub struct AuditHead {
    /// Its number.
    pub seq: i64,
    /// Its hash.
    pub sha256: String,
    /// When the chain was begun: what is older has no entries.
    pub begun_at_ms: i64,
    /// The database's clock when this was read.
    pub now_ms: i64,
}

/// What a transaction will add to the chain when it is committed.
#[derive(Clone, Debug)]
pub(super) struct Note {
    pub(super) event: &'static str,
    pub(super) subject: String,
    pub(super) detail: Value,
}

/// Rows of which the chain tells. What an entry says is computed from the row by the same function when the entry is written and when
/// `verify-store` compares the two.
pub(super) trait Noted: for<'r> FromRow<'r, AnyRow> + Send + Unpin {
    /// The rows with an id after $1 by id, at most $2.
    const EACH: &'static str;

    /// Whom the entries are about.
    fn subject(&self) -> &str;

    /// What the newest entry of each kind should say.
    fn said(&self) -> Vec<Said>;
}

/// What one entry should say of a row.
#[derive(Debug)]
pub(super) struct Said {
    pub(super) event: &'static str,
    /// Since when it is so, and the fields; none if it has not happened. A field's meaning never changes, as entries stay: what is new gets a
    /// field of its own.
    pub(super) now: Option<(i64, Value)>,
    /// The field that says who did it: entries from before there was that field have them as their actor.
    pub(super) by: Option<&'static str>,
}

impl Said {
    pub(super) fn created(event: &'static str, at_ms: i64, detail: Value) -> Self {
        Said { event, now: Some((at_ms, detail)), by: None }
    }
}

// The texts that the writer of a SQLite database joins others to.
macro_rules! insert_text {
    () => {
        "insert into audit (seq, at_ms, actor, event, subject, detail_json, sha256) values ($1, $2, $3, $4, $5, $6, $7)"
    };
}
macro_rules! head_text {
    () => {
        "select seq, sha256, begun_at_ms, (select now_ms from clock) as now_ms from audit_head"
    };
}
macro_rules! move_head_text {
    () => {
        "update audit_head set seq = $1, sha256 = $2"
    };
}
pub(super) use {head_text, insert_text, move_head_text};

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, HEAD, MOVE_HEAD, LIST, ACTOR, DETAIL];
pub(super) const QUERIES_POSTGRES: &[&str] = &[HEAD_LOCKED];

pub(super) const INSERT: &str = insert_text!();

const HEAD: &str = head_text!();

// The chain has one end: on PostgreSQL the transactions that add to it do so one after the other, as their last act.
const HEAD_LOCKED: &str = concat!(head_text!(), " for update");

const MOVE_HEAD: &str = move_head_text!();

const LIST: &str = "
    select seq, at_ms, actor, event, subject, detail_json, sha256 from audit where seq > $1 order by seq limit $2";

const ACTOR: &str = "select actor from audit where subject = $1 and event = $2 order by seq limit 1";

const DETAIL: &str = "select detail_json from audit where subject = $1 and event = $2 order by seq limit 1";

/// What the entry's hash is: of the JSON list of the hash before and all its fields.
pub(super) fn hash(before: &str, row: &AuditRow) -> String {
    let AuditRow { seq, at_ms, actor, event, subject, detail_json, .. } = row;
    let text = serde_json::json!([before, seq, at_ms, actor, event, subject, detail_json]).to_string();
    canonical::sha256_hex(text.as_bytes())
}

/// The end of the chain as this transaction sees it; others that add to it wait from now on.
pub(super) async fn head_in(connection: &mut AnyConnection) -> Result<AuditHead> {
    Ok(sqlx::query_as(HEAD_LOCKED).fetch_one(connection).await?)
}

/// Adds to the chain behind `head`; gives the new head, which the caller stores before the commit. `last` is [`INSERT`], with what is to be
/// done with the last entry.
pub(super) async fn append(
    connection: &mut AnyConnection,
    head: &AuditHead,
    actor: &str,
    notes: Vec<Note>,
    last: &'static str,
) -> Result<AuditHead> {
    let mut head = head.clone();
    let n = notes.len();
    for (i, Note { event, subject, detail }) in notes.into_iter().enumerate() {
        let seq = head.seq + 1;
        let (at_ms, detail_json) = (head.now_ms, detail.to_string());
        let mut row = AuditRow { seq, at_ms, actor: actor.into(), event: event.into(), subject, detail_json, sha256: String::new() };
        row.sha256 = hash(&head.sha256, &row);
        let query = sqlx::query(if i + 1 == n { last } else { INSERT });
        let query = query.bind(row.seq).bind(row.at_ms).bind(row.actor).bind(row.event).bind(row.subject);
        query.bind(row.detail_json).bind(&row.sha256).execute(&mut *connection).await?;
        head = AuditHead { seq: row.seq, sha256: row.sha256, ..head };
    }
    Ok(head)
}

/// Stores where the chain ends now.
pub(super) async fn move_head(connection: &mut AnyConnection, head: &AuditHead) -> Result<()> {
    sqlx::query(MOVE_HEAD).bind(head.seq).bind(&head.sha256).execute(connection).await?;
    Ok(())
}

/// The end of the chain.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn head(store: &Store) -> Result<AuditHead> {
    Ok(sqlx::query_as(HEAD).fetch_one(store.pool()).await?)
}

/// The entries after number `after`, in order, at most `limit`.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(store: &Store, after: i64, limit: i64) -> Result<Vec<AuditRow>> {
    Ok(sqlx::query_as(LIST).bind(after).bind(limit).fetch_all(store.pool()).await?)
}

/// Who first did this to that: the id of a key, as a rule.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn actor(store: &Store, subject: &str, event: &str) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(ACTOR).bind(subject).bind(event).fetch_optional(store.pool()).await?)
}

/// What was noted when this first happened to that.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn detail(store: &Store, subject: &str, event: &str) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(DETAIL).bind(subject).bind(event).fetch_optional(store.pool()).await?)
}
