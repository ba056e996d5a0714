//! Named documents of a robot: column mappings of its files, work frames, tools, and references of its instruments. A stored document never
//! changes; a new version under the same name replaces it.

use crate::wire::names;
use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, rows_after, values};
use super::{AuditEvent, ListRequest, Page, Result, Store, Tx, robots};
use crate::wire::canonical;

names! {
    /// Kind of a named document.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum NamedDocumentKind {
        /// A column mapping: the meaning of each column of a file.
        Columns = "columns",
        /// A work frame, in which targets are programmed.
        WorkFrame = "work_frame",
        /// A tool: the pose of its tool centre point.
        Tool = "tool",
        /// A reference: lengths with a certificate that the instrument measured.
        Reference = "reference",
    }
}

row! {
    /// One version of a document.
    #[derive(Clone, Debug, PartialEq)]
    pub struct NamedDocumentRow {
        /// `doc_…`; `col_…` for column mappings, `ref_…` for references.
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// Its kind, as [`NamedDocumentKind::as_str`].
        pub kind: String,
        /// Its name.
        pub name: String,
        /// Version, from 1. The highest version of a name is in force. This is a counter and not a time, because clocks may be set back.
        pub version: i64,
        /// The document in JSON.
        pub content_json: String,
        /// Id of the key that stored it.
        pub created_by: String,
        /// When it was stored.
        pub created_at_ms: i64,
    }
}

macro_rules! columns {
    () => {
        "id, robot_id, kind, name, version, content_json, created_by, created_at_ms"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, NEWEST, GET, BY_ID];

// The caller has locked the robot's row, so the version numbers have no gaps and no duplicates.
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

const GET: &str = concat!("select ", columns!(), " from named_document where id = $1");

pub(super) const LIST: ListQueries = ListQueries {
    columns: columns!(),
    from: "named_document",
    filter: "robot_id = $1 and kind = $2 and not exists (select 1 from named_document later where later.robot_id = named_document.robot_id
        and later.kind = named_document.kind and later.name = named_document.name and later.version > named_document.version)",
    n_filters: 2,
    name: None,
};

list_row!(NamedDocumentRow);

const BY_ID: &str = rows_after!(columns!(), "named_document");

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

    /// Content of the audit entry. Entries of column mappings use the older field name `columns_sha256`, so that old entries still match. Entries
    /// from before versions existed have no `version`.
    fn created_detail(&self) -> Value {
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

audited!(NamedDocumentRow, id, |row| vec![
    ExpectedEntry::at(row.event(), row.created_at_ms, row.created_detail()).by("created_by")
]);

/// A named document to be stored, with fields of [`NamedDocumentRow`].
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)] // as in the row
pub struct NewNamedDocument<'a> {
    pub robot_id: &'a str,
    pub kind: NamedDocumentKind,
    pub name: &'a str,
    pub content_json: &'a str,
    /// Id of the API key that stores it.
    pub by: &'a str,
}

/// Stores the next version of a document.
///
/// # Errors
/// [`super::Conflict::RobotArchived`], [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: NewNamedDocument<'_>) -> Result<NamedDocumentRow> {
    let prefix = match new.kind {
        NamedDocumentKind::Columns => IdPrefix::Columns,
        NamedDocumentKind::WorkFrame | NamedDocumentKind::Tool => IdPrefix::Document,
        NamedDocumentKind::Reference => IdPrefix::Reference,
    };
    tx.require_disk_space()?;
    robots::lock_in_use(tx, new.robot_id).await?;
    let values = values![
        prefix.new_id(),
        new.robot_id,
        new.kind.as_str(),
        new.name,
        new.content_json,
        new.by
    ];
    let row: NamedDocumentRow = sql::one(tx.connection(), INSERT, values).await?;
    tx.audit(row.event(), &row.id, row.created_detail());
    Ok(row)
}

/// The version that is in force under this name.
pub async fn newest(
    store: &Store,
    robot_id: &str,
    kind: NamedDocumentKind,
    name: &str,
) -> Result<NamedDocumentRow> {
    // PostgreSQL cannot store or compare text with a NUL character, so no document has such a name.
    if name.contains('\0') {
        return Err(super::Error::NotFound);
    }
    let values = values![robot_id, kind.as_str(), name];
    sql::one(store.readers(), NEWEST, values).await
}

/// The version with this id.
pub async fn get(store: &Store, id: &str) -> Result<NamedDocumentRow> {
    // PostgreSQL cannot compare text with a NUL character, so no document has such an id.
    if id.contains('\0') {
        return Err(super::Error::NotFound);
    }
    sql::one(store.readers(), GET, values![id]).await
}

/// A robot's documents of one kind that are in force, newest first.
pub async fn list(
    store: &Store,
    robot_id: &str,
    kind: NamedDocumentKind,
    request: &ListRequest,
) -> Result<Page<NamedDocumentRow>> {
    listing::list(store, &LIST, &[robot_id, kind.as_str()], request).await
}
