//! The summary of each job's report, see `wire::report_summary`.

use super::from_row::row;
use super::sql::{self, values};
use super::{Conflict, JobStatus, Result, Store, Tx};

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, OF_JOB, JOBS_WITHOUT, BY_ID];

const INSERT: &str = "
    insert into report_summary (job_id, summary_json) values ($1, $2) on conflict (job_id) do nothing";

// A job that a node of an older version ended has no summary until this server starts again. Its report is used instead, because the report has the
// fields of the summary.
const OF_JOB: &str = "
    select j.status as status, coalesce(s.summary_json, j.report_json) as summary_json
    from job j left join report_summary s on s.job_id = j.id where j.id = $1";

const JOBS_WITHOUT: &str = "
    select j.id from job j where j.status = 'succeeded' and j.id > $1
        and not exists (select 1 from report_summary s where s.job_id = j.id)
    order by j.id limit cast($2 as bigint)";

pub(super) const BY_ID: &str = "
    select s.job_id as job_id, s.summary_json as summary_json, coalesce(j.report_json, '') as report_json
    from report_summary s join job j on j.id = s.job_id where s.job_id > $1 order by s.job_id limit cast($2 as bigint)";

row! {
    /// A job's status and summary. The summary exists only if the job succeeded.
    struct OfJob {
        status: JobStatus,
        summary_json: Option<String>,
    }
}

row! {
    /// A summary together with the report that it was made from.
    pub(super) struct SummaryOfReport {
        /// The job.
        pub job_id: String,
        /// The summary.
        pub summary_json: String,
        /// The report.
        pub report_json: String,
    }
}

/// Stores a summary, unless the job already has one.
pub async fn insert(tx: &mut Tx, job_id: &str, summary_json: &str) -> Result<()> {
    sql::execute(tx.connection(), INSERT, values![job_id, summary_json]).await?;
    Ok(())
}

/// The summary of a job that succeeded.
///
/// # Errors
/// [`super::Error::NotFound`], [`Conflict::JobStatus`] if it did not succeed (yet), [`super::Error::Database`].
pub async fn of_job(store: &Store, job_id: &str) -> Result<String> {
    let row: OfJob = sql::one(store.readers(), OF_JOB, values![job_id]).await?;
    let status = row.status;
    row.summary_json
        .ok_or(Conflict::JobStatus { status }.into())
}

/// Ids of succeeded jobs without a summary, which an older version ended. In the order of their ids, at most `limit` ids after `after`.
pub async fn jobs_without(store: &Store, after: &str, limit: i64) -> Result<Vec<String>> {
    sql::all_values(store.readers(), JOBS_WITHOUT, values![after, limit]).await
}
