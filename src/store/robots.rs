//! Robots.

use serde_json::{Value, json};

use super::audit::{ExpectedEntry, audited};
use super::from_row::row;
use super::id_prefix::IdPrefix;
use super::listing::{self, ListQueries, list_row};
use super::sql::{self, rows_after, values};
use super::{AuditEvent, Conflict, ListRequest, Page, Result, Store, Tx};
use crate::wire::canonical;

row! {
    /// A robot as it is now.
    #[derive(Clone, Debug, PartialEq)]
    pub struct RobotRow {
        /// `rob_…`
        pub id: String,
        /// Its name; need not be unique.
        pub name: String,
        /// The robot document in JSON.
        pub body_json: String,
        /// When it was stored.
        pub created_at_ms: i64,
        /// Job of the session that did not fit the robot; set while the robot is in the state `check_robot`.
        pub check_job_id: Option<String>,
        /// Number of the last session that did not fit the robot, in the robot's counter of verifications; 0 for none. The number stays when the state
        /// `check_robot` ends.
        pub misfit_seq: i64,
        /// The robot's counter of verifications at the last `checked` request; 0 for none. The reason of this request explains all sessions up to that
        /// number.
        pub checked_seq: i64,
        /// Reason given by `checked`.
        pub checked_reason: Option<String>,
        /// Id of the key that called `checked`.
        pub checked_by: Option<String>,
        /// When `checked` was called.
        pub checked_at_ms: Option<i64>,
        /// Version after its last edit; 1 for a robot that was never edited.
        pub version: i64,
        /// Version of the robot in which its joint map last changed.
        pub joint_map_version: i64,
        /// When it was archived.
        pub archived_at_ms: Option<i64>,
        /// Its name in lower case, for sorting lists.
        pub sort_name: String,
    }
}

list_row!(RobotRow, sort_name);

impl RobotRow {
    /// The part of the row that a release depends on, see [`super::CheckedState`].
    pub fn check(&self) -> RobotCheck {
        RobotCheck {
            version: self.version,
            job_id: self.check_job_id.clone(),
            misfit_seq: self.misfit_seq,
            checked_seq: self.checked_seq,
        }
    }
}

/// The part of the robot's row that a release depends on; fields as in [`RobotRow`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)] // as in the row
pub struct RobotCheck {
    pub version: i64,
    pub job_id: Option<String>,
    pub misfit_seq: i64,
    pub checked_seq: i64,
}

/// A robot to be stored, with fields of [`RobotRow`].
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // as in the row
pub struct NewRobot {
    pub name: String,
    pub body_json: String,
}

macro_rules! columns {
    () => {
        "id, name, body_json, created_at_ms, check_job_id, check_seq as misfit_seq, checked_seq, checked_reason, checked_by, checked_at_ms, version, joint_map_version,
         archived_at_ms, sort_name"
    };
}

// Columns of a row in `robot`, with the document as it was created. A robot is never archived when it is created.
macro_rules! own_columns {
    () => {
        "id, name, body_json, created_at_ms, check_job_id, check_seq as misfit_seq, checked_seq, checked_reason, checked_by, checked_at_ms, version,
         cast(1 as bigint) as joint_map_version, cast(null as bigint) as archived_at_ms, lower(name) as sort_name"
    };
}

pub(super) const ALL_QUERIES: &[&str] = &[
    INSERT,
    GET,
    LOCK,
    LOCK_OF_JOB,
    BY_ID,
    BEGIN_CHECK,
    END_CHECK,
    MARK_CHECKED,
];

const INSERT: &str = concat!(
    "insert into robot (id, name, body_json, created_at_ms)
     values ($1, $2, $3, (select now_ms from clock))
     returning ",
    own_columns!()
);

const GET: &str = concat!("select ", columns!(), " from robot_now where id = $1");

// $1 is a comma-separated list of ids; '' for all robots. No id contains another id, so `replace` changes the list exactly if the list has the id.
pub(super) const LIST: ListQueries = ListQueries {
    columns: columns!(),
    from: "robot_now",
    filter: "($1 = '' or replace($1, id, '') <> $1)
        and ($2 = 'all' or ($2 = 'true') = (archived_at_ms is not null))
        and ($3 = '%' or sort_name like lower($3) escape '!' or lower(serial_number) like lower($3) escape '!')",
    n_filters: 3,
    name: Some("sort_name"),
};

// This update changes no value. It locks the robot's row, so that releases, policies and verifications of one robot are written one after the other.
const LOCK: &str = "update robot set name = name where id = $1";

const LOCK_OF_JOB: &str =
    "update robot set name = name where id = (select robot_id from job where id = $1)";

const BY_ID: &str = rows_after!(own_columns!(), "robot");

const BEGIN_CHECK: &str = "update robot set check_job_id = $2, check_seq = $3 where id = $1";

const END_CHECK: &str =
    "update robot set check_job_id = null where id = $1 and check_job_id is not null";

const MARK_CHECKED: &str = "
    update robot set check_job_id = null, checked_reason = $2, checked_by = $3, checked_at_ms = (select now_ms from clock),
        checked_seq = (select coalesce(max(v.seq), 0) from verification v where v.robot_id = robot.id)
    where id = $1";

/// Content of the audit entry about the creation. `row` comes from the table `robot`, so it has the document as it was created. After an
/// edit the name is left out, because it may have changed; the entry of the edit has the new name.
fn created_detail(row: &RobotRow) -> Value {
    let sha256 = canonical::sha256_hex(row.body_json.as_bytes());
    let mut created = json!({"sha256": sha256, "created_at_ms": row.created_at_ms});
    if row.version == 1 {
        created["name"] = json!(row.name);
    }
    created
}

fn edited_detail(row: &RobotRow) -> Option<(i64, Value)> {
    let detail = json!({"version": row.version, "name": row.name});
    // No column has the time of the edit, so the entry is required whatever its time.
    (row.version > 1).then_some((i64::MAX, detail))
}

fn checked_detail(row: &RobotRow) -> Value {
    json!({"reason": row.checked_reason, "checked_by": row.checked_by, "checked_at_ms": row.checked_at_ms, "checked_seq": row.checked_seq})
}

audited!(RobotRow, id, |row| vec![
    ExpectedEntry::at(
        AuditEvent::RobotCreated,
        row.created_at_ms,
        created_detail(row)
    ),
    ExpectedEntry::new(
        AuditEvent::RobotChecked,
        row.checked_at_ms.map(|at_ms| (at_ms, checked_detail(row)))
    )
    .by("checked_by"),
    ExpectedEntry::new(AuditEvent::RobotEdited, edited_detail(row)),
]);

/// As [`lock`], for the robot of a job.
pub(crate) async fn lock_of_job(tx: &mut Tx, job_id: &str) -> Result<()> {
    sql::execute(tx.connection(), LOCK_OF_JOB, values![job_id]).await?;
    Ok(())
}

/// Locks the robot's row until the transaction ends.
pub(super) async fn lock(tx: &mut Tx, id: &str) -> Result<()> {
    sql::execute(tx.connection(), LOCK, values![id]).await?;
    Ok(())
}

/// As [`lock`]; refuses an archived robot. Archiving locks the same row, so the robot stays in use until the transaction ends.
///
/// # Errors
/// [`Conflict::RobotArchived`], [`super::Error::NotFound`], [`super::Error::Database`].
pub(super) async fn lock_in_use(tx: &mut Tx, id: &str) -> Result<()> {
    lock(tx, id).await?;
    match get_in(tx, id).await?.archived_at_ms {
        Some(_) => Err(Conflict::RobotArchived.into()),
        None => Ok(()),
    }
}

/// Puts the robot into the state `check_robot`, because a session does not fit it.
pub async fn begin_check(tx: &mut Tx, id: &str, job_id: &str, seq: i64) -> Result<()> {
    sql::execute(tx.connection(), BEGIN_CHECK, values![id, job_id, seq]).await?;
    let detail = json!({"job_id": job_id, "check_seq": seq});
    tx.audit(AuditEvent::RobotDoesNotFit, id, detail);
    Ok(())
}

/// Ends the state `check_robot`, because a session fits the robot.
pub async fn end_check(tx: &mut Tx, id: &str, job_id: &str) -> Result<()> {
    if sql::execute(tx.connection(), END_CHECK, values![id]).await? > 0 {
        tx.audit(AuditEvent::RobotFitsAgain, id, json!({"job_id": job_id}));
    }
    Ok(())
}

/// Ends the state `check_robot` with a person's reason.
pub async fn checked(tx: &mut Tx, id: &str, reason: &str, by: &str) -> Result<RobotRow> {
    lock(tx, id).await?;
    sql::execute(tx.connection(), MARK_CHECKED, values![id, reason, by]).await?;
    let row = get_in(tx, id).await?;
    tx.audit(AuditEvent::RobotChecked, id, checked_detail(&row));
    Ok(row)
}

/// Stores a robot.
pub async fn insert(tx: &mut Tx, new: &NewRobot) -> Result<RobotRow> {
    tx.require_disk_space()?;
    let values = values![IdPrefix::Robot.new_id(), new.name, new.body_json];
    let row: RobotRow = sql::one(tx.connection(), INSERT, values).await?;
    tx.audit(AuditEvent::RobotCreated, &row.id, created_detail(&row));
    Ok(row)
}

/// One robot.
pub async fn get(store: &Store, id: &str) -> Result<RobotRow> {
    sql::one(store.readers(), GET, values![id]).await
}

pub(super) async fn get_in(tx: &mut Tx, id: &str) -> Result<RobotRow> {
    sql::one(tx.connection(), GET, values![id]).await
}

/// Robots, filtered by name, serial number and archived state; with `only`, only the robots with these ids.
pub async fn search(
    store: &Store,
    only: Option<&[String]>,
    request: &ListRequest,
) -> Result<Page<RobotRow>> {
    let only = only.map_or(String::new(), |ids| format!(",{}", ids.join(",")));
    let filters = [only.as_str(), request.archived.as_str(), &request.pattern()];
    listing::list(store, &LIST, &filters, request).await
}
