//! Mappings of the columns of a robot's files, by name. A mapping is never changed: a new one of the same name takes its place.

use serde_json::{Value, json};

use super::audit::{Audited, ExpectedEntry};
use super::database::new_id;
use super::from_row::from_row;
use super::listing::{self, ListKey, ListQueries, ListRow, list_queries};
use super::{AuditEvent, ListRequest, Listed, Result, Store, Tx};
use crate::wire::canonical;

/// A mapping.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnMappingRow {
    /// `col_…`
    pub id: String,
    /// Its robot.
    pub robot_id: String,
    /// Its name.
    pub name: String,
    /// The mapping in JSON.
    pub columns_json: String,
    /// Id of the key that stored it.
    pub created_by: String,
    /// When it was stored.
    pub created_at_ms: i64,
}

from_row!(ColumnMappingRow {
    id,
    robot_id,
    name,
    columns_json,
    created_by,
    created_at_ms
});

macro_rules! columns {
    () => {
        "id, robot_id, name, columns_json, created_by, created_at_ms"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, NEWEST, BY_ID];

const INSERT: &str = concat!(
    "insert into column_mapping (id, robot_id, name, columns_json, created_by, created_at_ms)
     values ($1, $2, $3, $4, $5, (select now_ms from clock))
     returning ",
    columns!()
);

// Ids ascend with the time, also within a millisecond.
const NEWEST: &str = concat!(
    "select ",
    columns!(),
    " from column_mapping where robot_id = $1 and name = $2 order by id desc limit 1"
);

pub(super) const LIST: ListQueries = list_queries!(
    columns!(),
    "column_mapping",
    "robot_id = $1 and id in (select max(newest.id) from column_mapping newest where newest.robot_id = $1 group by newest.name)",
    "$2",
    "$3",
    "$4"
);

impl ListRow for ColumnMappingRow {
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
    " from column_mapping where id > $1 order by id limit cast($2 as bigint)"
);

fn as_created(row: &ColumnMappingRow) -> Value {
    json!({"robot_id": row.robot_id, "name": row.name, "created_by": row.created_by, "created_at_ms": row.created_at_ms,
        "columns_sha256": canonical::sha256_hex(row.columns_json.as_bytes())})
}

impl Audited for ColumnMappingRow {
    const BY_ID: &'static str = BY_ID;

    fn subject(&self) -> &str {
        &self.id
    }

    fn expected_entries(&self) -> Vec<ExpectedEntry> {
        vec![ExpectedEntry {
            by: Some("created_by"),
            ..ExpectedEntry::created(
                AuditEvent::ColumnMappingCreated,
                self.created_at_ms,
                as_created(self),
            )
        }]
    }
}

/// Stores a mapping.
///
/// # Errors
/// [`super::Error::NotFound`] if there is no such robot, [`super::Error::Database`].
pub async fn insert(
    tx: &mut Tx,
    robot_id: &str,
    name: &str,
    columns_json: &str,
    by: &str,
) -> Result<ColumnMappingRow> {
    let query = sqlx::query_as(INSERT)
        .bind(new_id("col"))
        .bind(robot_id)
        .bind(name)
        .bind(columns_json)
        .bind(by);
    tx.needs_room()?;
    let row: ColumnMappingRow = query.fetch_one(tx.connection()).await?;
    tx.audit(AuditEvent::ColumnMappingCreated, &row.id, as_created(&row));
    Ok(row)
}

/// The mapping of this name.
///
/// # Errors
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn newest(store: &Store, robot_id: &str, name: &str) -> Result<ColumnMappingRow> {
    Ok(sqlx::query_as(NEWEST)
        .bind(robot_id)
        .bind(name)
        .fetch_one(store.readers())
        .await?)
}

/// A robot's mappings, the newest of each name, newest first.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(
    store: &Store,
    robot_id: &str,
    request: &ListRequest,
) -> Result<Listed<ColumnMappingRow>> {
    listing::list(store, &LIST, &[robot_id], request).await
}
