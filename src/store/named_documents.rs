//! What a robot has under a name: mappings of the columns of its files, work frames and tools. A document is never changed: the next version of its
//! name takes its place.

use crate::wire::names;
use serde_json::{Value, json};

use super::audit::{Audited, ExpectedEntry};
use super::database::new_id;
use super::from_row::from_row;
use super::listing::{self, ListQueries, list_queries, list_row};
use super::{AuditEvent, ListRequest, Listed, Result, Store, Tx, robots};
use crate::wire::canonical;

/// What is kept under a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NamedDocumentKind {
    /// What the columns of a file mean.
    Columns,
    /// A frame in which targets are programmed.
    WorkFrame,
    /// A tool centre point with its orientation.
    Tool,
}

names!(NamedDocumentKind { Columns = "columns", WorkFrame = "work_frame", Tool = "tool" });

/// One version of a document.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedDocumentRow {
    /// `doc_…`; `col_…` for mappings of columns.
    pub id: String,
    /// Its robot.
    pub robot_id: String,
    /// As [`NamedDocumentKind::as_str`].
    pub kind: String,
    /// Its name.
    pub name: String,
    /// From 1; the highest of a name is the one in force. A counter, because clocks may be set back.
    pub version: i64,
    /// The document in JSON.
    pub content_json: String,
    /// Id of the key that stored it.
    pub created_by: String,
    /// When it was stored.
    pub created_at_ms: i64,
}

from_row!(NamedDocumentRow {
    id,
    robot_id,
    kind,
    name,
    version,
    content_json,
    created_by,
    created_at_ms
});

macro_rules! columns {
    () => {
        "id, robot_id, kind, name, version, content_json, created_by, created_at_ms"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, NEWEST, BY_ID];

// The robot's row is locked, so the counter has no gaps and no duplicates.
const INSERT: &str = concat!(
    "insert into named_document (id, robot_id, kind, name, version, content_json, created_by, created_at_ms)
     values ($1, $2, $3, $4,
        (select coalesce(max(d.version), 0) + 1 from named_document d where d.robot_id = $2 and d.kind = $3 and d.name = $4),
        $5, $6, (select now_ms from clock))
     returning ",
    columns!()
);

const NEWEST: &str = concat!(
    "select ",
    columns!(),
    " from named_document where robot_id = $1 and kind = $2 and name = $3 order by version desc limit 1"
);

pub(super) const LIST: ListQueries = list_queries!(
    columns!(),
    "named_document",
    "robot_id = $1 and kind = $2 and not exists (select 1 from named_document later where later.robot_id = named_document.robot_id
        and later.kind = named_document.kind and later.name = named_document.name and later.version > named_document.version)",
    "$3",
    "$4",
    "$5"
);

list_row!(NamedDocumentRow);

const BY_ID: &str = concat!(
    "select ",
    columns!(),
    " from named_document where id > $1 order by id limit cast($2 as bigint)"
);

impl NamedDocumentRow {
    fn is_columns(&self) -> bool {
        self.kind == NamedDocumentKind::Columns.as_str()
    }

    fn event(&self) -> AuditEvent {
        if self.is_columns() {
            AuditEvent::ColumnMappingCreated
        } else {
            AuditEvent::NamedFrameCreated
        }
    }

    /// Mappings of columns keep the names that their entries had before there were versions; such an entry has none.
    fn as_created(&self) -> Value {
        let sha256 = canonical::sha256_hex(self.content_json.as_bytes());
        if self.is_columns() {
            json!({"robot_id": self.robot_id, "name": self.name, "version": self.version, "created_by": self.created_by,
                "created_at_ms": self.created_at_ms, "columns_sha256": sha256})
        } else {
            json!({"robot_id": self.robot_id, "kind": self.kind, "name": self.name, "version": self.version, "created_by": self.created_by,
                "created_at_ms": self.created_at_ms, "content_sha256": sha256})
        }
    }
}

impl Audited for NamedDocumentRow {
    const BY_ID: &'static str = BY_ID;

    fn subject(&self) -> &str {
        &self.id
    }

    fn expected_entries(&self) -> Vec<ExpectedEntry> {
        vec![ExpectedEntry {
            by: Some("created_by"),
            ..ExpectedEntry::created(self.event(), self.created_at_ms, self.as_created())
        }]
    }
}

/// What is stored.
#[derive(Clone, Copy, Debug)]
pub struct NewNamedDocument<'a> {
    /// Its robot.
    pub robot_id: &'a str,
    /// What it is.
    pub kind: NamedDocumentKind,
    /// Its name.
    pub name: &'a str,
    /// Its content in JSON.
    pub content_json: &'a str,
    /// Id of the key.
    pub by: &'a str,
}

/// Stores the next version of a document.
///
/// # Errors
/// [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: NewNamedDocument<'_>) -> Result<NamedDocumentRow> {
    let prefix = match new.kind {
        NamedDocumentKind::Columns => "col",
        NamedDocumentKind::WorkFrame | NamedDocumentKind::Tool => "doc",
    };
    tx.require_disk_space()?;
    robots::lock(tx, new.robot_id).await?;
    let row: NamedDocumentRow = sqlx::query_as(INSERT)
        .bind(new_id(prefix))
        .bind(new.robot_id)
        .bind(new.kind.as_str())
        .bind(new.name)
        .bind(new.content_json)
        .bind(new.by)
        .fetch_one(tx.connection())
        .await?;
    tx.audit(row.event(), &row.id, row.as_created());
    Ok(row)
}

/// The version that is in force under this name.
///
/// # Errors
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn newest(
    store: &Store,
    robot_id: &str,
    kind: NamedDocumentKind,
    name: &str,
) -> Result<NamedDocumentRow> {
    // nothing has a name that cannot be stored
    if name.contains('\0') {
        return Err(super::Error::NotFound);
    }
    Ok(sqlx::query_as(NEWEST)
        .bind(robot_id)
        .bind(kind.as_str())
        .bind(name)
        .fetch_one(store.readers())
        .await?)
}

/// A robot's documents of a kind that are in force, newest first.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(
    store: &Store,
    robot_id: &str,
    kind: NamedDocumentKind,
    request: &ListRequest,
) -> Result<Listed<NamedDocumentRow>> {
    listing::list(store, &LIST, &[robot_id, kind.as_str()], request).await
}
