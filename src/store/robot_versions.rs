//! Versions of edited robots. The row in `robot` keeps the robot as it was created. Each edit adds a row here. A job refers to the version that it
//! was posted with, so that its result can be computed and read again.

use serde_json::{Value, json};

use super::from_row::row;
use super::robots::{self, RobotRow};
use super::sql::{self, values};
use super::{AuditEvent, Conflict, Result, Store, Tx};
use crate::wire::canonical;

row! {
    /// A robot after an edit.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub(super) struct RobotVersionRow {
        pub(super) robot_id: String,
        pub(super) version: i64,
        pub(super) joint_map_version: i64,
        pub(super) body_json: String,
        pub(super) changed_by: String,
        pub(super) changed_at_ms: i64,
    }
}

/// An edit of a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotEdit {
    /// Version that was edited. If it is not the robot's last version, nothing is stored.
    pub edited_version: i64,
    /// Its name after the edit.
    pub name: String,
    /// The robot document after the edit, in JSON.
    pub body_json: String,
    /// Whether the joint map has changed.
    pub changes_joint_map: bool,
    /// Names of the fields that have changed.
    pub changed: Vec<&'static str>,
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, MOVE, AT, FIRST, ALL];

const INSERT: &str = "
    insert into robot_version (robot_id, version, joint_map_version, body_json, changed_by, changed_at_ms)
    select r.id, r.version + 1, case when cast($3 as bigint) = 1 then r.version + 1 else r.joint_map_version end, $4, $5, (select now_ms from clock)
    from robot_now r where r.id = $1 and r.version = $2
    returning robot_id, version, joint_map_version, body_json, changed_by, changed_at_ms";

const MOVE: &str = "update robot set version = $2, name = $3 where id = $1";

const AT: &str = "select body_json from robot_version where robot_id = $1 and version = $2";

const FIRST: &str = "select body_json from robot where id = $1";

// Versions after ($1, $2) = (robot, version), in order.
const ALL: &str = "
    select robot_id, version, joint_map_version, body_json, changed_by, changed_at_ms from robot_version
    where (robot_id, version) > ($1, $2) order by robot_id, version limit cast($3 as bigint)";

/// Content of the audit entry about an edit.
pub(super) fn edited_detail(row: &RobotVersionRow) -> Value {
    json!({"version": row.version, "joint_map_version": row.joint_map_version, "sha256": canonical::sha256_hex(row.body_json.as_bytes()),
        "changed_by": row.changed_by, "changed_at_ms": row.changed_at_ms})
}

/// Stores a new version of a robot.
///
/// # Errors
/// [`Conflict::RobotChanged`] if the robot was edited in the meantime, [`Conflict::JointMapReleased`], [`Conflict::RobotArchived`],
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn edit(tx: &mut Tx, id: &str, edit: &RobotEdit, by: &str) -> Result<RobotRow> {
    tx.require_disk_space()?;
    robots::lock_in_use(tx, id).await?;
    let values = values![
        id,
        edit.edited_version,
        i64::from(edit.changes_joint_map),
        edit.body_json,
        by
    ];
    let row: Option<RobotVersionRow> = sql::first(tx.connection(), INSERT, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|_| Conflict::JointMapReleased))?;
    let row = row.ok_or(Conflict::RobotChanged)?;
    sql::execute(tx.connection(), MOVE, values![id, row.version, edit.name]).await?;
    tx.audit(AuditEvent::RobotEdited, id, edited_detail(&row));
    tx.audit_field("name", edit.name.as_str().into());
    tx.audit_field("changed", json!(edit.changed));
    robots::get_in(tx, id).await
}

/// A robot as it was in a version.
pub async fn robot_at(store: &Store, robot_id: &str, version: i64) -> Result<RobotRow> {
    let mut row = robots::get(store, robot_id).await?;
    if row.version == version {
        return Ok(row);
    }
    row.body_json = match version > 1 {
        true => sql::value(store.readers(), AT, values![robot_id, version]).await?,
        false => sql::value(store.readers(), FIRST, values![robot_id]).await?,
    };
    row.version = version;
    Ok(row)
}

/// At most `limit` versions after this one, sorted by robot and version.
pub(super) async fn after(
    store: &Store,
    robot_id: &str,
    version: i64,
    limit: i64,
) -> Result<Vec<RobotVersionRow>> {
    sql::all(store.readers(), ALL, values![robot_id, version, limit]).await
}
