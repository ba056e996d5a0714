//! Robots.

use serde_json::{Value, json};

use super::audit::{Noted, Said};
use super::{Page, PageRequest, Result, Store, Tx, new_id};
use crate::wire::canonical;

/// A robot.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub struct RobotRow {
    /// `rob_…`
    pub id: String,
    /// Need not be unique.
    pub name: String,
    /// The robot document.
    pub body_json: String,
    /// When it was stored.
    pub created_at_ms: i64,
}

/// A robot to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewRobot {
    /// Need not be unique.
    pub name: String,
    /// The robot document.
    pub body_json: String,
}

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, GET, LIST, LOCK, LOCK_OF_JOB, EACH];

const INSERT: &str = "
    insert into robot (id, name, body_json, created_at_ms)
    values ($1, $2, $3, (select now_ms from clock))
    returning id, name, body_json, created_at_ms";

const GET: &str = "select id, name, body_json, created_at_ms from robot where id = $1";

// $1 is the list of the robots wanted, with commas; '' for all. An id has no other id in it, so taking it out of the
// list changes the list exactly if it is there.
const LIST: &str = "
    select id, name, body_json, created_at_ms from robot
    where ($1 = '' or replace($1, id, '') <> $1) and (created_at_ms, id) < ($2, $3)
    order by created_at_ms desc, id desc
    limit cast($4 as bigint)";

// Changes nothing, but on both engines what decides about this robot waits for who did this before: a release, a policy, a session's score.
const LOCK: &str = "update robot set name = name where id = $1";

const LOCK_OF_JOB: &str =
    "update robot set name = name where id = (select robot_id from job where id = $1)";

const EACH: &str = "select id, name, body_json, created_at_ms from robot where id > $1 order by id limit cast($2 as bigint)";

const CREATED: &str = "robot_created";

fn as_created(row: &RobotRow) -> Value {
    let sha256 = canonical::sha256_hex(row.body_json.as_bytes());
    json!({"sha256": sha256, "name": row.name, "created_at_ms": row.created_at_ms})
}

impl Noted for RobotRow {
    const EACH: &'static str = EACH;

    fn subject(&self) -> &str {
        &self.id
    }

    fn said(&self) -> Vec<Said> {
        vec![Said::created(CREATED, self.created_at_ms, as_created(self))]
    }
}

/// As [`lock`], of the robot of a job.
pub(crate) async fn lock_of_job(tx: &mut Tx, job_id: &str) -> Result<()> {
    sqlx::query(LOCK_OF_JOB)
        .bind(job_id)
        .execute(tx.connection()?)
        .await?;
    Ok(())
}

/// Makes a transaction wait for others that decide about the same robot, and them for it.
pub(super) async fn lock(tx: &mut Tx, id: &str) -> Result<()> {
    sqlx::query(LOCK).bind(id).execute(tx.connection()?).await?;
    Ok(())
}

/// Stores a robot.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: &NewRobot) -> Result<RobotRow> {
    let query = sqlx::query_as(INSERT)
        .bind(new_id("rob"))
        .bind(&new.name)
        .bind(&new.body_json);
    tx.needs_room()?;
    let row: RobotRow = query.fetch_one(tx.connection()?).await?;
    tx.note(CREATED, &row.id, as_created(&row));
    Ok(row)
}

/// One robot.
///
/// # Errors
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn get(store: &Store, id: &str) -> Result<RobotRow> {
    Ok(sqlx::query_as(GET)
        .bind(id)
        .fetch_one(store.reads())
        .await?)
}

/// Robots, newest first; with `only`, of those ids.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(
    store: &Store,
    only: Option<&[String]>,
    request: &PageRequest,
) -> Result<Page<RobotRow>> {
    let only = only.map_or(String::new(), |ids| format!(",{}", ids.join(",")));
    let keyset = request.keyset();
    let query = sqlx::query_as(LIST)
        .bind(only)
        .bind(keyset.created_at_ms)
        .bind(keyset.id)
        .bind(keyset.limit);
    let rows: Vec<RobotRow> = query.fetch_all(store.reads()).await?;
    Ok(request.page(rows, |row| (row.created_at_ms, &row.id)))
}
