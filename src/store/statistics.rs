//! State of the queue, for `/metrics`.

use super::from_row::row;
use super::sql::{self, values};
use super::{JobStatus, Result, Store};

row! {
    /// The jobs of one status.
    #[derive(Clone, Debug, PartialEq)]
    pub struct JobStatistics {
        /// The status.
        pub status: JobStatus,
        /// Number of jobs.
        pub n_jobs: i64,
        /// Age of the oldest job since it was posted, ms.
        pub oldest_age_ms: i64,
        /// Number of these jobs that have started.
        pub n_begun: i64,
        /// Sum of the times from posting to the (last) start, ms.
        pub waited_ms: i64,
        /// Sum of the times from the (last) start to the end, ms.
        pub ran_ms: i64,
    }
}

pub(super) const ALL_QUERIES: &[&str] = &[JOBS];

// On PostgreSQL the sum of a bigint column has the type numeric, so the sums are cast to bigint.
const JOBS: &str = "
    select status, count(*) as n_jobs,
        cast(max(now_ms - created_at_ms) as bigint) as oldest_age_ms,
        count(started_at_ms) as n_begun,
        cast(coalesce(sum(started_at_ms - created_at_ms), 0) as bigint) as waited_ms,
        cast(coalesce(sum(finished_at_ms - started_at_ms), 0) as bigint) as ran_ms
    from job cross join (select now_ms from clock) as clock_now
    group by status
    order by status";

/// Statistics for each status; a status without jobs has no row.
pub async fn jobs(store: &Store) -> Result<Vec<JobStatistics>> {
    sql::all(store.readers(), JOBS, values![]).await
}
