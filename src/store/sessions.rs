//! The sessions that a parameter set was scored on: succeeded jobs of kind `verify`.

use super::{Result, Store, Tx};

/// One such job.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
pub struct SessionRow {
    /// The job.
    pub job_id: String,
    /// Its whole report.
    pub report_json: String,
    /// When it was posted.
    pub created_at_ms: i64,
}

pub(super) const ALL_QUERIES: &[&str] = &[NEWEST, COUNT];

const NEWEST: &str = "
    select id as job_id, report_json, created_at_ms from job
    where kind = 'verify' and parameter_set_input_id = $1 and status = 'succeeded'
    order by created_at_ms desc, id desc limit $2";

const COUNT: &str = "select count(*) from job where kind = 'verify' and parameter_set_input_id = $1 and status = 'succeeded'";

/// The newest sessions of a parameter set.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn newest(store: &Store, parameter_set_id: &str, limit: i64) -> Result<Vec<SessionRow>> {
    Ok(sqlx::query_as(NEWEST).bind(parameter_set_id).bind(limit).fetch_all(store.pool()).await?)
}

/// How many sessions there are.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn count(store: &Store, parameter_set_id: &str) -> Result<i64> {
    Ok(sqlx::query_scalar(COUNT).bind(parameter_set_id).fetch_one(store.pool()).await?)
}

pub(super) async fn count_in(tx: &mut Tx, parameter_set_id: &str) -> Result<i64> {
    Ok(sqlx::query_scalar(COUNT).bind(parameter_set_id).fetch_one(tx.connection()?).await?)
}
