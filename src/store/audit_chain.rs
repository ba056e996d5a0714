//! The audit chain. Every creation, release, withdrawal, end of a job and change of a key adds an entry, in the same transaction.
//! The hash of an entry covers its content and the hash of the entry before. An edited, deleted or moved entry is thus detected.
//!
//! A person who can write to the database can also compute a new chain. To detect that, store the head of the chain elsewhere (`kincal verify-store`
//! prints it) and compare it later (`--known-head`).

use std::fmt;
use std::str::FromStr;

use serde_json::Value;
use sqlx::AnyConnection;

use super::from_row::row;
use super::sql::{self, values};
use super::{AuditEvent, Engine, Result};
use crate::wire::canonical;

row! {
    /// One entry of the chain.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct AuditRow {
        /// 1, 2, 3, ….
        pub seq: i64,
        /// Time of the event, by the database's clock.
        pub at_ms: i64,
        /// The id of the key, `worker`, `command line`, ….
        pub actor: String,
        /// `robot_created`, `parameter_set_released`, ….
        pub event: String,
        /// Id of the robot, job, set, … that the entry is about.
        pub subject: String,
        /// Further facts in JSON: hashes, reasons.
        pub detail_json: String,
        /// SHA-256 of this entry and of the previous hash, hexadecimal.
        pub sha256: String,
    }
}

row! {
    /// The chain's newest entry; number 0 and an empty hash if there is none.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct AuditHead {
        /// Its number.
        pub seq: i64,
        /// Its hash.
        pub sha256: String,
        /// Start of the chain; older rows have no entries.
        pub begun_at_ms: i64,
        /// The database's clock when this was read.
        pub now_ms: i64,
    }
}

impl AuditHead {
    /// Its number and hash.
    pub fn entry(&self) -> AuditEntryId {
        AuditEntryId {
            seq: self.seq,
            sha256: self.sha256.clone(),
        }
    }

    /// Makes `next` the head of the chain.
    fn follow(&mut self, next: &AuditRow) {
        (self.seq, self.sha256) = (next.seq, next.sha256.clone());
    }
}

/// Number and hash of an entry, written as NUMBER:HASH. An empty chain has number 0 and an empty hash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditEntryId {
    /// Number.
    pub seq: i64,
    /// Hash of the entry, hexadecimal.
    pub sha256: String,
}

/// The text is not a valid [`AuditEntryId`].
#[derive(Debug, thiserror::Error)]
#[error("not a number, a colon and a hash")]
pub struct NoAuditEntryId;

impl fmt::Display for AuditEntryId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.seq, self.sha256)
    }
}

impl FromStr for AuditEntryId {
    type Err = NoAuditEntryId;

    fn from_str(text: &str) -> std::result::Result<Self, NoAuditEntryId> {
        let (seq, sha256) = text.split_once(':').ok_or(NoAuditEntryId)?;
        let seq = seq.parse().map_err(|_| NoAuditEntryId)?;
        let is_hexadecimal = sha256
            .bytes()
            .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
        let is_of_empty_chain = seq == 0 && sha256.is_empty();
        if is_of_empty_chain || (sha256.len() == 64 && is_hexadecimal) {
            Ok(Self {
                seq,
                sha256: sha256.into(),
            })
        } else {
            Err(NoAuditEntryId)
        }
    }
}

/// An entry that a transaction adds to the chain when it is committed.
#[derive(Clone, Debug)]
pub(super) struct AuditNote {
    pub(super) event: AuditEvent,
    pub(super) subject: String,
    pub(super) detail: Value,
}

macro_rules! head_text {
    () => {
        "select seq, sha256, begun_at_ms, (select now_ms from clock) as now_ms from audit_head"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, HEAD, MOVE_HEAD];
pub(super) const QUERIES_POSTGRES: &[&str] = &[HEAD_LOCKED];

const INSERT: &str = "insert into audit (seq, at_ms, actor, event, subject, detail_json, sha256) values ($1, $2, $3, $4, $5, $6, $7)";

pub(super) const HEAD: &str = head_text!();

// On PostgreSQL the head is locked: transactions append one after the other, as their last statement before the commit.
const HEAD_LOCKED: &str = concat!(head_text!(), " for update");

const MOVE_HEAD: &str = "update audit_head set seq = $1, sha256 = $2";

/// SHA-256 of the JSON list of the previous hash and the entry's fields.
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

/// The entries that follow `head`.
fn entries(head: &AuditHead, actor: &str, notes: Vec<AuditNote>) -> Vec<AuditRow> {
    let mut head = head.clone();
    let entry = |AuditNote {
                     event,
                     subject,
                     detail,
                 }| {
        let (at_ms, detail_json) = (head.now_ms, detail.to_string());
        let mut row = AuditRow {
            seq: head.seq + 1,
            at_ms,
            actor: actor.into(),
            event: event.as_str().into(),
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

/// Appends to the chain, as the last statement of a transaction.
pub(super) async fn append(
    connection: &mut AnyConnection,
    engine: Engine,
    actor: &str,
    notes: Vec<AuditNote>,
) -> Result<()> {
    let head = match engine {
        // No lock is needed: the transaction holds SQLite's only write lock.
        Engine::Sqlite => HEAD,
        Engine::Postgres => HEAD_LOCKED,
    };
    let head: AuditHead = sql::one(&mut *connection, head, values![]).await?;
    let entries = entries(&head, actor, notes);
    for row in &entries {
        let values = values![
            row.seq,
            row.at_ms,
            row.actor,
            row.event,
            row.subject,
            row.detail_json,
            row.sha256
        ];
        sql::execute(&mut *connection, INSERT, values).await?;
    }
    if let Some(last) = entries.last() {
        sql::execute(connection, MOVE_HEAD, values![last.seq, last.sha256]).await?;
    }
    Ok(())
}
