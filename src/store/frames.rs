//! Base and tool frames computed from sweeps, with the uploaded sweeps.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::sql::{self, values};
use super::{AuditEvent, Conflict, Hashed, Result, Store, Tx};
use crate::wire::canonical;

row! {
    /// Frames computed from one upload of sweeps.
    #[derive(Clone, Debug, PartialEq)]
    pub struct FramesRow {
        /// `frm_…`
        pub id: String,
        /// Its robot.
        pub robot_id: String,
        /// Media type of the upload.
        pub content_type: String,
        /// Frames and circles in JSON.
        pub result_json: String,
        /// When it was stored.
        pub created_at_ms: i64,
    }
}

/// Frames to be stored, with fields of [`FramesRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewFrames {
    pub robot_id: String,
    pub content_type: String,
    /// The uploaded bytes.
    pub body: Hashed<Vec<u8>>,
    pub result_json: String,
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, GET, BY_ID];

const INSERT: &str = "
    insert into frames (id, robot_id, content_type, body, result_json, created_at_ms)
    values ($1, $2, $3, $4, $5, (select now_ms from clock))
    returning id, robot_id, content_type, result_json, created_at_ms";

const GET: &str =
    "select id, robot_id, content_type, result_json, created_at_ms from frames where id = $1";

const BY_ID: &str = "
    select id, robot_id, content_type, result_json, created_at_ms from frames where id > $1 order by id limit cast($2 as bigint)";

// The row does not contain the uploaded bytes. `insert` adds their hash to the audit entry.
fn created_detail(row: &FramesRow) -> Value {
    json!({"robot_id": row.robot_id, "content_type": row.content_type, "created_at_ms": row.created_at_ms,
        "result_sha256": canonical::sha256_hex(row.result_json.as_bytes())})
}

audited!(FramesRow, id, |row| vec![ExpectedEntry::at(
    AuditEvent::FramesCreated,
    row.created_at_ms,
    created_detail(row)
)]);

/// Stores frames.
pub async fn insert(tx: &mut Tx, new: &NewFrames) -> Result<FramesRow> {
    tx.require_disk_space()?;
    let values = values![
        IdPrefix::Frames.new_id(),
        new.robot_id,
        new.content_type,
        new.body.content(),
        new.result_json
    ];
    let row: FramesRow = sql::one(tx.connection(), INSERT, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|_| Conflict::RobotArchived))?;
    tx.audit(AuditEvent::FramesCreated, &row.id, created_detail(&row));
    tx.audit_field("sha256", new.body.sha256().into());
    Ok(row)
}

/// The frames with this id.
pub async fn get(store: &Store, id: &str) -> Result<FramesRow> {
    sql::one(store.readers(), GET, values![id]).await
}
