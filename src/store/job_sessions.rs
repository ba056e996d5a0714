//! The measurement sets of a job with several sessions, without the first set.

use super::sql::{self, values};
use super::{Result, Tx};

/// SQL for the ids of a job's further sets: in order, separated by commas.
macro_rules! further_set_ids {
    () => {
        "coalesce((select string_agg(s.measurement_set_id, ',' order by s.place) from job_session s where s.job_id = job.id), '')"
    };
}

pub(super) use further_set_ids;

pub(super) const ALL_QUERIES: &[&str] = &[INSERT];

const INSERT: &str =
    "insert into job_session (job_id, place, measurement_set_id) values ($1, $2, $3)";

/// Stores the further sets of a job.
///
/// # Errors
/// [`super::Error::NotFound`] for a set that does not exist, [`super::Error::Database`].
pub(super) async fn insert(tx: &mut Tx, job_id: &str, further_set_ids: &[String]) -> Result<()> {
    for (place, set_id) in (1_i64..).zip(further_set_ids) {
        sql::execute(tx.connection(), INSERT, values![job_id, place, set_id]).await?;
    }
    Ok(())
}
