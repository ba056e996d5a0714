//! The source jobs of each job, direct and indirect. A job's result depends on a source job in one of two ways: it holds parameter values that the
//! source job identified, or its residual network was trained on from the source job's network.

use super::from_row::row;
use super::sql::{self, values};
use super::{Result, Store, Tx};

pub(super) const ALL_QUERIES: &[&str] = &[INSERT_HELD, INSERT_RESIDUAL, UPLOADS];

const INSERT_HELD: &str = "
    insert into job_source (job_id, source_job_id, is_held)
    select cast($1 as text), p.job_id, 1 from parameter_set p where p.id = $2
    union select cast($1 as text), s.source_job_id, s.is_held from job_source s join parameter_set p on p.job_id = s.job_id where p.id = $2";

const INSERT_RESIDUAL: &str = "
    insert into job_source (job_id, source_job_id, is_held)
    select j.id, r.job_id, 0 from job j join residual_network r on r.id = j.residual_network_input_id where j.id = $1
    union select j.id, s.source_job_id, 0 from job j join residual_network r on r.id = j.residual_network_input_id
        join job_source s on s.job_id = r.job_id where j.id = $1";

const UPLOADS: &str = "
    select u.measurement_set_id as measurement_set_id, max(s.is_held) as is_held from job_source s join job_upload u on u.job_id = s.source_job_id
    where s.job_id = $1 group by u.measurement_set_id order by u.measurement_set_id";

row! {
    /// An upload of a source job: the job's result depends on it.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct SourceUpload {
        /// The measurement set.
        pub measurement_set_id: String,
        /// Whether the job holds parameter values that were identified from this upload. Otherwise a residual network was trained on it.
        pub is_held: bool,
    }
}

/// Stores the sources of a new job that holds the values of a parameter set. The sources of a job never change.
pub(super) async fn insert_held(tx: &mut Tx, job_id: &str, parameter_set_id: &str) -> Result<()> {
    let values = values![job_id, parameter_set_id];
    sql::execute(tx.connection(), INSERT_HELD, values).await?;
    Ok(())
}

/// Stores the sources of a job that continued the training of an earlier residual network and kept the result.
pub async fn insert_residual(tx: &mut Tx, job_id: &str) -> Result<()> {
    sql::execute(tx.connection(), INSERT_RESIDUAL, values![job_id]).await?;
    Ok(())
}

/// Uploads of the job's sources.
pub async fn uploads(store: &Store, job_id: &str) -> Result<Vec<SourceUpload>> {
    sql::all(store.readers(), UPLOADS, values![job_id]).await
}
