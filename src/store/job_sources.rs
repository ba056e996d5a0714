//! The jobs that a job's result rests on: it holds parameters that they identified, or continues to train their residual network. Their own sources
//! are among them.

use super::{Result, Store, Tx};

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, UPLOADS, WITHDRAWN];

const INSERT: &str = "
    with direct as (
        select p.job_id from parameter_set p where p.id = cast($2 as text)
        union select r.job_id from residual_network r where r.id = cast($3 as text))
    insert into job_source (job_id, source_job_id)
    select cast($1 as text), d.job_id from direct d
    union select cast($1 as text), s.source_job_id from job_source s join direct d on d.job_id = s.job_id";

const UPLOADS: &str = "
    select distinct u.measurement_set_id from job_source s join job_upload u on u.job_id = s.source_job_id where s.job_id = $1 order by u.measurement_set_id";

const WITHDRAWN: &str = "
    select p.id from job_source s join parameter_set p on p.job_id = s.source_job_id
    where s.job_id = $1 and p.status = 'withdrawn' order by p.id limit 1";

/// Stores the sources of a new job, which never change.
///
/// # Errors
/// [`super::Error::Database`].
pub(super) async fn insert(
    tx: &mut Tx,
    job_id: &str,
    held_parameter_set_id: Option<&str>,
    residual_network_id: Option<&str>,
) -> Result<()> {
    sqlx::query(INSERT)
        .bind(job_id)
        .bind(held_parameter_set_id)
        .bind(residual_network_id)
        .execute(tx.connection())
        .await?;
    Ok(())
}

/// Measurement sets of the job's sources, without the job's own.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn uploads(store: &Store, job_id: &str) -> Result<Vec<String>> {
    Ok(sqlx::query_scalar(UPLOADS)
        .bind(job_id)
        .fetch_all(store.readers())
        .await?)
}

/// A parameter set of the job's sources that was withdrawn, if there is one.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn withdrawn(store: &Store, job_id: &str) -> Result<Option<String>> {
    Ok(sqlx::query_scalar(WITHDRAWN)
        .bind(job_id)
        .fetch_optional(store.readers())
        .await?)
}
