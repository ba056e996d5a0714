//! Work frames and tools of a robot, by name. One is never changed: a new one of the same name takes its place.

use serde_json::{Value, json};

use super::audit::{Audited, ExpectedEntry};
use super::database::new_id;
use super::from_row::from_row;
use super::listing::{self, ListKey, ListQueries, ListRow, list_queries};
use super::{AuditEvent, ListRequest, Listed, Result, Store, Tx};
use crate::wire::canonical;
use crate::wire::named_frame::NamedFrameKind;

/// A work frame or a tool.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedFrameRow {
    /// `nfr_…`
    pub id: String,
    /// Its robot.
    pub robot_id: String,
    /// `work_frame` or `tool`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// What was stored, in JSON.
    pub content_json: String,
    /// Id of the key that stored it.
    pub created_by: String,
    /// When it was stored.
    pub created_at_ms: i64,
}

from_row!(NamedFrameRow {
    id,
    robot_id,
    kind,
    name,
    content_json,
    created_by,
    created_at_ms
});

macro_rules! columns {
    () => {
        "id, robot_id, kind, name, content_json, created_by, created_at_ms"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, NEWEST, BY_ID];

const INSERT: &str = concat!(
    "insert into named_frame (id, robot_id, kind, name, content_json, created_by, created_at_ms)
     values ($1, $2, $3, $4, $5, $6, (select now_ms from clock))
     returning ",
    columns!()
);

// Ids ascend with the time, also within a millisecond.
const NEWEST: &str = concat!(
    "select ",
    columns!(),
    " from named_frame where robot_id = $1 and kind = $2 and name = $3 order by id desc limit 1"
);

pub(super) const LIST: ListQueries = list_queries!(
    columns!(),
    "named_frame",
    "robot_id = $1 and kind = $2
     and id in (select max(newest.id) from named_frame newest where newest.robot_id = $1 and newest.kind = $2 group by newest.name)",
    "$3",
    "$4",
    "$5"
);

impl ListRow for NamedFrameRow {
    fn key(&self) -> ListKey<'_> {
        ListKey {
            created_at_ms: self.created_at_ms,
            name: "",
            id: &self.id,
        }
    }
}

const BY_ID: &str = concat!(
    "select ",
    columns!(),
    " from named_frame where id > $1 order by id limit cast($2 as bigint)"
);

fn as_created(row: &NamedFrameRow) -> Value {
    json!({"robot_id": row.robot_id, "kind": row.kind, "name": row.name, "created_by": row.created_by, "created_at_ms": row.created_at_ms,
        "content_sha256": canonical::sha256_hex(row.content_json.as_bytes())})
}

impl Audited for NamedFrameRow {
    const BY_ID: &'static str = BY_ID;

    fn subject(&self) -> &str {
        &self.id
    }

    fn expected_entries(&self) -> Vec<ExpectedEntry> {
        vec![ExpectedEntry {
            by: Some("created_by"),
            ..ExpectedEntry::created(
                AuditEvent::NamedFrameCreated,
                self.created_at_ms,
                as_created(self),
            )
        }]
    }
}

/// What is stored.
#[derive(Clone, Copy, Debug)]
pub struct NewNamedFrame<'a> {
    /// Its robot.
    pub robot_id: &'a str,
    /// A work frame or a tool.
    pub kind: NamedFrameKind,
    /// Its name.
    pub name: &'a str,
    /// Its content in JSON.
    pub content_json: &'a str,
    /// Id of the key.
    pub by: &'a str,
}

/// Stores a work frame or a tool.
///
/// # Errors
/// [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: NewNamedFrame<'_>) -> Result<NamedFrameRow> {
    let query = sqlx::query_as(INSERT)
        .bind(new_id("nfr"))
        .bind(new.robot_id)
        .bind(new.kind.as_str())
        .bind(new.name)
        .bind(new.content_json)
        .bind(new.by);
    tx.needs_room()?;
    let row: NamedFrameRow = query.fetch_one(tx.connection()).await?;
    tx.audit(AuditEvent::NamedFrameCreated, &row.id, as_created(&row));
    Ok(row)
}

/// The one that holds under this name.
///
/// # Errors
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn newest(
    store: &Store,
    robot_id: &str,
    kind: NamedFrameKind,
    name: &str,
) -> Result<NamedFrameRow> {
    Ok(sqlx::query_as(NEWEST)
        .bind(robot_id)
        .bind(kind.as_str())
        .bind(name)
        .fetch_one(store.readers())
        .await?)
}

/// A robot's work frames or tools, the newest of each name, newest first.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(
    store: &Store,
    robot_id: &str,
    kind: NamedFrameKind,
    request: &ListRequest,
) -> Result<Listed<NamedFrameRow>> {
    listing::list(store, &LIST, &[robot_id, kind.as_str()], request).await
}
