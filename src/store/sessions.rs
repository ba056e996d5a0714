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

pub(super) const ALL_QUERIES: &[&str] = &[NEWEST, COUNT, NO_BETTER];

// Of jobs on the same bytes the newest counts: a session scored again and again does not push others out.
const NEWEST: &str = "
    select job.id as job_id, job.report_json, job.created_at_ms from job
    join (select job.id, row_number() over (partition by measurement_set.sha256 order by job.created_at_ms desc, job.id desc) as place
          from job join measurement_set on measurement_set.id = job.measurement_set_id
          where job.kind = 'verify' and job.parameter_set_input_id = $1 and job.status = 'succeeded') newest
        on newest.id = job.id and newest.place = 1
    order by job.created_at_ms desc, job.id desc limit cast($2 as bigint)";

const COUNT: &str = "select count(*) from job where kind = 'verify' and parameter_set_input_id = $1 and status = 'succeeded'";

// As the trigger parameter_set_no_better asks.
const NO_BETTER: &str = "
    select id from job where kind = 'verify' and parameter_set_input_id = $1 and status = 'succeeded'
        and report_json like '%\"code\":\"no_better_than_nominal\"%'
    order by created_at_ms desc, id desc limit 1";

/// The newest sessions of a parameter set, one for each upload.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn newest(store: &Store, parameter_set_id: &str, limit: i64) -> Result<Vec<SessionRow>> {
    Ok(sqlx::query_as(NEWEST)
        .bind(parameter_set_id)
        .bind(limit)
        .fetch_all(store.reads())
        .await?)
}

/// How many sessions there are.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn count(store: &Store, parameter_set_id: &str) -> Result<i64> {
    Ok(sqlx::query_scalar(COUNT)
        .bind(parameter_set_id)
        .fetch_one(store.reads())
        .await?)
}

/// The job that showed the set to be no better than nominal, if one did: of all sessions, however many came since.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn no_better_than_nominal(
    store: &Store,
    parameter_set_id: &str,
) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(NO_BETTER)
        .bind(parameter_set_id)
        .fetch_optional(store.reads_much())
        .await?)
}

pub(super) async fn count_in(tx: &mut Tx, parameter_set_id: &str) -> Result<i64> {
    Ok(sqlx::query_scalar(COUNT)
        .bind(parameter_set_id)
        .fetch_one(tx.connection()?)
        .await?)
}
