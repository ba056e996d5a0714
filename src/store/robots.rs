//! Robots.

use serde_json::json;

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

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, GET, LIST];

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
    limit $4";

/// Stores a robot.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn insert(tx: &mut Tx, new: &NewRobot) -> Result<RobotRow> {
    let query = sqlx::query_as(INSERT).bind(new_id("rob")).bind(&new.name).bind(&new.body_json);
    tx.needs_room()?;
    let row: RobotRow = query.fetch_one(tx.connection()?).await?;
    tx.note("robot_created", &row.id, &json!({"sha256": canonical::sha256_hex(row.body_json.as_bytes())}));
    Ok(row)
}

/// One robot.
///
/// # Errors
/// [`super::Error::NotFound`], [`super::Error::Database`].
pub async fn get(store: &Store, id: &str) -> Result<RobotRow> {
    Ok(sqlx::query_as(GET).bind(id).fetch_one(store.pool()).await?)
}

/// Robots, newest first; with `only`, of those ids.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn list(store: &Store, only: Option<&[String]>, request: &PageRequest) -> Result<Page<RobotRow>> {
    let only = only.map_or(String::new(), |ids| format!(",{}", ids.join(",")));
    let keyset = request.keyset();
    let query = sqlx::query_as(LIST).bind(only).bind(keyset.created_at_ms).bind(keyset.id).bind(keyset.limit);
    let rows: Vec<RobotRow> = query.fetch_all(store.pool()).await?;
    Ok(request.page(rows, |row| (row.created_at_ms, &row.id)))
}
