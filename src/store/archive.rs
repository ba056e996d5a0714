//! Archived items: robots, measurement sets, jobs, candidate parameter sets and networks. The row of an archived item stays, and so does everything
//! that refers to the row. Lists leave the item out.

use crate::wire::names;
use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::sql::{self, values};
use super::{AuditEvent, Conflict, Result, Tx};

names! {
    /// Kind of an item that can be archived.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Archivable {
        /// A robot.
        Robot = "robot",
        /// A measurement set.
        MeasurementSet = "measurement_set",
        /// A job that has ended.
        Job = "job",
        /// A parameter set that was never released.
        ParameterSet = "parameter_set",
        /// A network of either kind.
        Network = "network",
    }
}

row! {
    /// An archived item.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct ArchivedRow {
        /// Its id.
        pub id: String,
        /// Its kind, as text, because `verify` must be able to read any text.
        pub kind: String,
        /// Id of its robot. For a robot, this is its own id.
        pub robot_id: String,
        /// Id of the key that archived it.
        pub archived_by: String,
        /// When it was archived.
        pub archived_at_ms: i64,
    }
}

pub(super) const ALL_QUERIES: &[&str] = &[ARCHIVE, SINCE, KIND, RESTORE, BY_ID];

const ARCHIVE: &str = "
    insert into archived (id, kind, robot_id, archived_by, archived_at_ms) values ($1, $2, $3, $4, (select now_ms from clock))
    on conflict (id) do nothing
    returning id, kind, robot_id, archived_by, archived_at_ms";

const SINCE: &str = "select archived_at_ms from archived where id = $1";

const KIND: &str = "select kind from archived where id = $1";

const RESTORE: &str = "delete from archived where id = $1";

const BY_ID: &str = "
    select id, kind, robot_id, archived_by, archived_at_ms from archived where id > $1 order by id limit cast($2 as bigint)";

fn archived_detail(row: &ArchivedRow) -> Value {
    json!({"kind": row.kind, "robot_id": row.robot_id, "archived_by": row.archived_by, "archived_at_ms": row.archived_at_ms})
}

audited!(ArchivedRow, id, |row| vec![
    ExpectedEntry::at(
        AuditEvent::Archived,
        row.archived_at_ms,
        archived_detail(row)
    )
    .by("archived_by")
]);

/// Archives an item; archiving it again changes nothing. Returns when it was archived.
///
/// # Errors
/// [`Conflict::NotArchivable`] for a parameter set that was released and for a job that has not ended, [`super::Error::Database`].
pub async fn archive(
    tx: &mut Tx,
    kind: Archivable,
    id: &str,
    robot_id: &str,
    by: &str,
) -> Result<i64> {
    // Locks the robot's row. This waits until a release of the robot that is under way has ended.
    super::robots::lock(tx, robot_id).await?;
    let values = values![id, kind.as_str(), robot_id, by];
    let row: Option<ArchivedRow> = sql::first(tx.connection(), ARCHIVE, values)
        .await
        .map_err(|error| error.into_conflict_of_trigger(|why| Conflict::NotArchivable { why }))?;
    if let Some(row) = row {
        tx.audit(AuditEvent::Archived, id, archived_detail(&row));
        return Ok(row.archived_at_ms);
    }
    sql::value(tx.connection(), SINCE, values![id]).await
}

/// Refuses archived items of a robot. The transaction must have locked the robot's row: archiving locks it too, so the items stay in use until
/// the transaction ends.
///
/// # Errors
/// [`Conflict::Archived`] with the first of them, [`super::Error::Database`].
pub(super) async fn require_in_use(tx: &mut Tx, ids: impl Iterator<Item = &str>) -> Result<()> {
    for id in ids {
        let kind: Option<String> = sql::first_value(tx.connection(), KIND, values![id]).await?;
        if let Some(kind) = kind {
            let what = kind.replace('_', " ");
            let id = id.to_owned();
            return Err(Conflict::Archived { what, id }.into());
        }
    }
    Ok(())
}

/// Restores an archived item; restoring an item that is not archived changes nothing.
pub async fn restore(tx: &mut Tx, kind: Archivable, id: &str, robot_id: &str) -> Result<()> {
    super::robots::lock(tx, robot_id).await?;
    if sql::execute(tx.connection(), RESTORE, values![id]).await? > 0 {
        let detail = json!({"kind": kind.as_str(), "robot_id": robot_id});
        tx.audit(AuditEvent::Restored, id, detail);
    }
    Ok(())
}
