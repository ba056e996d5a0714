//! The audit chain: every creation, release, withdrawal, end of a job and change of a key, in the transaction that did it.
//! Each entry's hash covers its content and the hash before it, so that an edit, a deletion or another order shows.
//!
//! Whoever can write to the database can also compute a new chain from the edit on. Against that, keep a head elsewhere now
//! and then (`kincal verify-store` prints it) and have it looked for later (`--known-head`).

use serde_json::Value;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, FromRow};

use super::connection::Connection;
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

impl AuditHead {
    /// Goes on to the next entry.
    pub(super) fn follow(&mut self, next: &AuditRow) {
        (self.seq, self.sha256) = (next.seq, next.sha256.clone());
    }
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
        Said {
            event,
            now: Some((at_ms, detail)),
            by: None,
        }
    }
}

macro_rules! head_text {
    () => {
        "select seq, sha256, begun_at_ms, (select now_ms from clock) as now_ms from audit_head"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, HEAD, MOVE_HEAD, LIST, ACTOR, DETAIL];
pub(super) const QUERIES_POSTGRES: &[&str] = &[HEAD_LOCKED];

const INSERT: &str = "insert into audit (seq, at_ms, actor, event, subject, detail_json, sha256) values ($1, $2, $3, $4, $5, $6, $7)";

pub(super) const HEAD: &str = head_text!();

// The chain has one end: on PostgreSQL the transactions that add to it do so one after the other, as their last act.
const HEAD_LOCKED: &str = concat!(head_text!(), " for update");

const MOVE_HEAD: &str = "update audit_head set seq = $1, sha256 = $2";

const LIST: &str = "
    select seq, at_ms, actor, event, subject, detail_json, sha256 from audit where seq > $1 order by seq limit cast($2 as bigint)";

const ACTOR: &str =
    "select actor from audit where subject = $1 and event = $2 order by seq limit 1";

const DETAIL: &str =
    "select detail_json from audit where subject = $1 and event = $2 order by seq limit 1";

/// What the entry's hash is: of the JSON list of the hash before and all its fields.
pub(super) fn hash(before: &str, row: &AuditRow) -> String {
    let AuditRow {
        seq,
        at_ms,
        actor,
        event,
        subject,
        detail_json,
        ..
    } = row;
    let text =
        serde_json::json!([before, seq, at_ms, actor, event, subject, detail_json]).to_string();
    canonical::sha256_hex(text.as_bytes())
}

/// What `notes` become behind `head`.
pub(super) fn entries(head: &AuditHead, actor: &str, notes: Vec<Note>) -> Vec<AuditRow> {
    let mut head = head.clone();
    let entry = |Note {
                     event,
                     subject,
                     detail,
                 }| {
        let (at_ms, detail_json) = (head.now_ms, detail.to_string());
        let mut row = AuditRow {
            seq: head.seq + 1,
            at_ms,
            actor: actor.into(),
            event: event.into(),
            subject,
            detail_json,
            sha256: String::new(),
        };
        row.sha256 = hash(&head.sha256, &row);
        head.follow(&row);
        row
    };
    notes.into_iter().map(entry).collect()
}

/// Writes entries that follow each other, as the last act of a transaction.
pub(super) async fn write(mut connection: Connection<'_>, entries: &[AuditRow]) -> Result<()> {
    for row in entries {
        let query = sqlx::query(INSERT)
            .bind(row.seq)
            .bind(row.at_ms)
            .bind(&row.actor)
            .bind(&row.event)
            .bind(&row.subject);
        query
            .bind(&row.detail_json)
            .bind(&row.sha256)
            .execute(connection.again())
            .await?;
    }
    if let Some(last) = entries.last() {
        sqlx::query(MOVE_HEAD)
            .bind(last.seq)
            .bind(&last.sha256)
            .execute(connection)
            .await?;
    }
    Ok(())
}

/// Adds to the chain, as the last act of a transaction on PostgreSQL.
pub(super) async fn append(
    connection: &mut AnyConnection,
    actor: &str,
    notes: Vec<Note>,
) -> Result<()> {
    let head: AuditHead = sqlx::query_as(HEAD_LOCKED)
        .fetch_one(&mut *connection)
        .await?;
    write(Connection::Sqlx(connection), &entries(&head, actor, notes)).await
}

/// The end of the chain.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn head(store: &Store) -> Result<AuditHead> {
    Ok(sqlx::query_as(HEAD).fetch_one(store.reads()).await?)
}

/// The entries after number `after`, in order, at most `limit`.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(store: &Store, after: i64, limit: i64) -> Result<Vec<AuditRow>> {
    Ok(sqlx::query_as(LIST)
        .bind(after)
        .bind(limit)
        .fetch_all(store.reads())
        .await?)
}

/// Who first did this to that: the id of a key, as a rule.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn actor(store: &Store, subject: &str, event: &str) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(ACTOR)
        .bind(subject)
        .bind(event)
        .fetch_optional(store.reads())
        .await?)
}

/// What was noted when this first happened to that.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn detail(store: &Store, subject: &str, event: &str) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(DETAIL)
        .bind(subject)
        .bind(event)
        .fetch_optional(store.reads())
        .await?)
}
