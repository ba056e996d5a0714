//! Leases of workers on jobs. Every update checks the fencing token (owner, attempt). So a worker that was suspended or disconnected cannot change a
//! job that it has lost: it gets [`Conflict::LeaseLost`].

use std::time::Duration;

use serde_json::json;
use sqlx::any::AnyArguments;

use super::sql::{self, values};
use super::{
    AuditEvent, Conflict, Engine, Hashed, JobRow, Result, Store, Tx, jobs, report_summaries,
};

/// A worker's lease on a job: the fencing token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job_id: String,
    /// The worker. A worker gets a new name at every start.
    pub owner: String,
    /// Number of the attempt, from 1.
    pub attempt: i64,
}

impl Lease {
    /// The lease of `owner` on a job that it has claimed.
    pub fn new(job: &JobRow, owner: &str) -> Lease {
        Lease {
            job_id: job.id.clone(),
            owner: owner.to_owned(),
            attempt: job.attempt,
        }
    }
}

/// The documents of a job that succeeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobResult<'a> {
    /// The whole report.
    pub report_json: &'a Hashed<String>,
    /// The summary of the report, see `wire::report_summary`.
    pub summary_json: &'a str,
    /// The convergence curve.
    pub convergence_json: &'a Hashed<String>,
    /// SHA-256 of the result, hexadecimal.
    pub result_sha256: &'a str,
}

/// Answer to a worker that renews its lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Whether cancellation of the job was requested.
    pub cancel_requested: bool,
}

/// Ids of the jobs whose leases expired, by their new state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Expired {
    /// Jobs that are queued again.
    pub queued: Vec<String>,
    /// Jobs that failed, because they have no attempts left.
    pub failed: Vec<String>,
    /// Jobs that are cancelled, because cancellation was requested.
    pub cancelled: Vec<String>,
}

/// Which of the waiting jobs may be claimed. A suspect is a job during which a process died. Only a process that computes nothing else may claim a
/// suspect, so that another death of a process points to exactly one job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eligible {
    /// Jobs during which no process died.
    Unsuspected,
    /// Jobs during which a process died, or lost its connection to the database for longer than the lease.
    Suspect,
}

macro_rules! claim {
    ($which:literal, $lock:literal) => {
        concat!(
            "update job set status = 'running', owner = $1, attempt = attempt + 1,
                 lease_until_ms = (select now_ms from clock) + $2, started_at_ms = (select now_ms from clock), progress_json = null
             where status = 'queued' and id = (
                 select id from job where status = 'queued' and deaths ",
            $which,
            " order by deaths, priority desc, turn, created_at_ms, id limit 1",
            $lock,
            ")
             returning ",
            jobs::columns!()
        )
    };
}

/// An update with the fencing condition: the job is still running, with this owner and this attempt.
macro_rules! fenced {
    ($update:literal, $returning:literal) => {
        concat!(
            "update job set ",
            $update,
            " where id = $1 and owner = $2 and attempt = $3 and status = 'running' returning ",
            $returning
        )
    };
}

/// The values to bind: first those of the fencing condition, then those of the update.
macro_rules! fenced_values {
    ($lease:ident $(, $value:expr)*) => {
        values![$lease.job_id, $lease.owner, $lease.attempt $(, $value)*]
    };
}

macro_rules! expired {
    ($update:expr, $condition:expr) => {
        concat!(
            $update,
            " where status = 'running' and lease_until_ms < (select now_ms from clock) and ",
            $condition,
            " returning id"
        )
    };
}

/// SQL: 1 if the lease expired because the process died, froze or lost its connection; 0 if the worker gave up ([`GIVE_UP`] sets
/// `lease_until_ms` to 0).
macro_rules! died_now {
    () => {
        "(case when lease_until_ms > 0 then 1 else 0 end)"
    };
}

/// SQL: number of attempts that count against the limit. These are the attempts that the job itself ended, by a panic or by taking too long.
/// `attempt` also counts the attempts during which a process died, because a frozen worker may resume and must not hold a valid fencing token. So the
/// deaths are subtracted.
macro_rules! counted_attempts {
    () => {
        concat!("(attempt - deaths - ", died_now!(), ")")
    };
}

pub(super) const QUERIES_SQLITE: &[&str] = &[CLAIM_SQLITE, CLAIM_SUSPECT_SQLITE];
pub(super) const QUERIES_POSTGRES: &[&str] = &[CLAIM_POSTGRES, CLAIM_SUSPECT_POSTGRES];
pub(super) const ALL_QUERIES: &[&str] = &[
    HEARTBEAT,
    SUCCEED,
    FAIL,
    CANCELLED,
    HAND_BACK,
    GIVE_UP,
    N_EXPIRED,
    EXPIRE_CANCELLED,
    EXPIRE_AFTER_ATTEMPTS,
    EXPIRE_AFTER_DEATHS,
    EXPIRE_QUEUED,
    EXPIRE_ALL,
];

const CLAIM_SQLITE: &str = claim!("= 0", "");
const CLAIM_SUSPECT_SQLITE: &str = claim!("> 0", "");
// `skip locked`: workers that claim at the same moment take different rows and do not wait for each other.
const CLAIM_POSTGRES: &str = claim!("= 0", " for update skip locked");
const CLAIM_SUSPECT_POSTGRES: &str = claim!("> 0", " for update skip locked");

const HEARTBEAT: &str = fenced!(
    "lease_until_ms = (select now_ms from clock) + $4, progress_json = coalesce($5, progress_json)",
    "cancel_requested_at_ms"
);

const SUCCEED: &str = fenced!(
    "status = case when cancel_requested_at_ms is null then 'succeeded' else 'cancelled' end,
     report_json = case when cancel_requested_at_ms is null then $4 end,
     convergence_json = case when cancel_requested_at_ms is null then $5 end,
     result_sha256 = case when cancel_requested_at_ms is null then $6 end,
     lease_until_ms = null, finished_at_ms = (select now_ms from clock)",
    "status"
);

const FAIL: &str = fenced!(
    "status = case when cancel_requested_at_ms is null then 'failed' else 'cancelled' end,
     error_json = case when cancel_requested_at_ms is null then $4 end,
     lease_until_ms = null, finished_at_ms = (select now_ms from clock)",
    "status"
);

const CANCELLED: &str = fenced!(
    "status = 'cancelled', lease_until_ms = null, finished_at_ms = (select now_ms from clock)",
    "status"
);

const GIVE_UP: &str = fenced!("lease_until_ms = 0", "status");

const HAND_BACK: &str = fenced!(
    "status = case when cancel_requested_at_ms is null then 'queued' else 'cancelled' end,
     finished_at_ms = case when cancel_requested_at_ms is null then null else (select now_ms from clock) end,
     attempt = attempt - 1, owner = null, lease_until_ms = null, started_at_ms = null, progress_json = null",
    "status"
);

const N_EXPIRED: &str = "select count(*) from job where status = 'running' and lease_until_ms < (select now_ms from clock)";

const EXPIRE_CANCELLED: &str = expired!(
    "update job set status = 'cancelled', lease_until_ms = null, finished_at_ms = (select now_ms from clock)",
    "cancel_requested_at_ms is not null"
);

macro_rules! failed {
    () => {
        concat!(
            "update job set status = 'failed', error_json = $2, deaths = deaths + ",
            died_now!(),
            ", lease_until_ms = null, finished_at_ms = (select now_ms from clock)"
        )
    };
}

const EXPIRE_AFTER_ATTEMPTS: &str = expired!(failed!(), concat!(counted_attempts!(), " >= $1"));

const EXPIRE_AFTER_DEATHS: &str = expired!(failed!(), concat!("deaths + ", died_now!(), " > $1"));

const EXPIRE_QUEUED: &str = expired!(
    concat!(
        "update job set status = 'queued', deaths = deaths + ",
        died_now!(),
        ", owner = null, lease_until_ms = null, started_at_ms = null, progress_json = null"
    ),
    concat!(
        counted_attempts!(),
        " < $1 and deaths + ",
        died_now!(),
        " <= $2"
    )
);

// Expires the leases of dead workers. The lease is set to 1, because 0 means that the worker gave up.
const EXPIRE_ALL: &str =
    "update job set lease_until_ms = 1 where status = 'running' and lease_until_ms > 0";

/// Maximum number of process deaths while the process computes only this job; then the job fails. A death is usually not caused by the job and does
/// not use up an attempt. But a job that overflows the stack kills every process that computes it, so deaths need a limit too. The first death does
/// not count against this limit, because other jobs may have run in that process. Later deaths count, because suspects run alone.
pub const MAX_DEATHS_ALONE: i64 = 5;

/// Claims the next waiting job, ordered by number of deaths, then by priority, then by turn. The worker has the job once the transaction is
/// committed. Only a process that computes nothing else may ask for a suspect.
pub async fn claim_in(
    tx: &mut Tx,
    eligible: Eligible,
    owner: &str,
    lease: Duration,
) -> Result<Option<JobRow>> {
    let statement = match (tx.engine(), eligible) {
        (Engine::Sqlite, Eligible::Unsuspected) => CLAIM_SQLITE,
        (Engine::Sqlite, Eligible::Suspect) => CLAIM_SUSPECT_SQLITE,
        (Engine::Postgres, Eligible::Unsuspected) => CLAIM_POSTGRES,
        (Engine::Postgres, Eligible::Suspect) => CLAIM_SUSPECT_POSTGRES,
    };
    sql::first(tx.connection(), statement, values![owner, millis(lease)]).await
}

/// Renews a lease, stores the progress if there is some, and reads the cancel flag, all in one statement.
pub async fn heartbeat(
    store: &Store,
    lease: &Lease,
    duration: Duration,
    progress_json: Option<&str>,
) -> Result<Heartbeat> {
    let mut tx = store.begin().await?;
    let values = fenced_values![lease, millis(duration), progress_json];
    let cancel_requested_at_ms: Option<Option<i64>> =
        sql::first_value(tx.connection(), HEARTBEAT, values).await?;
    let Some(cancel_requested_at_ms) = cancel_requested_at_ms else {
        tx.rollback().await?;
        return Err(Conflict::LeaseLost.into());
    };
    tx.commit().await?;
    Ok(Heartbeat {
        cancel_requested: cancel_requested_at_ms.is_some(),
    })
}

/// Ends a job with its report. Returns false if cancellation was requested; the job is then cancelled and no report is stored.
///
/// # Errors
/// [`Conflict::LeaseLost`], [`super::Error::Database`]; the transaction must then not be committed.
pub async fn succeed(tx: &mut Tx, lease: &Lease, result: &JobResult<'_>) -> Result<bool> {
    let values = fenced_values![
        lease,
        result.report_json.content(),
        result.convergence_json.content(),
        result.result_sha256
    ];
    if !end(tx, lease, SUCCEED, values).await? {
        return Ok(false);
    }
    report_summaries::insert(tx, &lease.job_id, result.summary_json).await?;
    let detail = json!({"result_sha256": result.result_sha256, "report_sha256": result.report_json.sha256(),
        "convergence_sha256": result.convergence_json.sha256()});
    tx.audit(AuditEvent::JobSucceeded, &lease.job_id, detail);
    Ok(true)
}

/// Ends a job with an error. If cancellation was requested, the job is cancelled instead.
pub async fn fail(tx: &mut Tx, lease: &Lease, error_json: &str) -> Result<bool> {
    let has_failed = end(tx, lease, FAIL, fenced_values![lease, error_json]).await?;
    if has_failed {
        let detail = jobs::failed_detail(error_json);
        tx.audit(AuditEvent::JobFailed, &lease.job_id, detail);
    }
    Ok(has_failed)
}

/// Ends a job as cancelled.
pub async fn cancelled(tx: &mut Tx, lease: &Lease) -> Result<()> {
    end(tx, lease, CANCELLED, fenced_values![lease]).await?;
    Ok(())
}

/// Puts a job back into the queue without counting the attempt. If cancellation was requested, the job is cancelled instead.
pub async fn hand_back(tx: &mut Tx, lease: &Lease) -> Result<()> {
    end(tx, lease, HAND_BACK, fenced_values![lease]).await?;
    Ok(())
}

/// Ends the lease without a result. The attempt counts.
pub async fn give_up(tx: &mut Tx, lease: &Lease) -> Result<()> {
    end(tx, lease, GIVE_UP, fenced_values![lease]).await?;
    Ok(())
}

/// Runs an update that ends an attempt, as the worker. Returns false if the job is cancelled now.
async fn end(
    tx: &mut Tx,
    lease: &Lease,
    update: &'static str,
    values: AnyArguments,
) -> Result<bool> {
    tx.act_as(&lease.owner);
    let status: Option<String> = sql::first_value(tx.connection(), update, values).await?;
    let is_cancelled = status.ok_or(Conflict::LeaseLost)? == "cancelled";
    if is_cancelled {
        tx.audit(AuditEvent::JobCancelled, &lease.job_id, json!({}));
    }
    Ok(!is_cancelled)
}

/// The problem documents of jobs that are given up.
#[derive(Clone, Debug, Default)]
pub struct Exhausted {
    /// After too many attempts that the job itself ended.
    pub by_attempts_json: String,
    /// After too many deaths of a process that computed only this job.
    pub by_deaths_json: String,
}

/// Takes jobs from workers whose leases have expired. A job is queued again, as a suspect if its process died. It fails with a problem of
/// `exhausted` after `max_attempts` attempts that the job itself ended, or after [`MAX_DEATHS_ALONE`] deaths of a process that computed only this job.
pub async fn expire(store: &Store, max_attempts: i64, exhausted: &Exhausted) -> Result<Expired> {
    // Usually no lease has expired. Reading this first avoids the write lock.
    let n_expired: i64 = sql::value(store.readers(), N_EXPIRED, values![]).await?;
    if n_expired == 0 {
        return Ok(Expired::default());
    }
    let mut tx = store.begin().await?;
    let cancelled = sql::all_values(tx.connection(), EXPIRE_CANCELLED, values![]).await?;
    let mut failed: Vec<String> = Vec::new();
    for (statement, limit, problem_json) in [
        (
            EXPIRE_AFTER_ATTEMPTS,
            max_attempts,
            &exhausted.by_attempts_json,
        ),
        (
            EXPIRE_AFTER_DEATHS,
            MAX_DEATHS_ALONE,
            &exhausted.by_deaths_json,
        ),
    ] {
        let values = values![limit, problem_json];
        let ids: Vec<String> = sql::all_values(tx.connection(), statement, values).await?;
        for id in &ids {
            tx.audit(AuditEvent::JobFailed, id, jobs::failed_detail(problem_json));
            tx.audit_field("code", "attempts_exhausted".into());
        }
        failed.extend(ids);
    }
    let values = values![max_attempts, MAX_DEATHS_ALONE];
    let queued = sql::all_values(tx.connection(), EXPIRE_QUEUED, values).await?;
    cancelled
        .iter()
        .for_each(|id: &String| tx.audit(AuditEvent::JobCancelled, id, json!({})));
    tx.commit().await?;
    Ok(Expired {
        queued,
        failed,
        cancelled,
    })
}

/// Ends every lease. Only the process that has locked the data directory may call this: all earlier workers are then dead.
pub(super) async fn expire_all(store: &Store) -> Result<()> {
    let mut tx = store.begin().await?;
    sql::execute(tx.connection(), EXPIRE_ALL, values![]).await?;
    tx.commit().await
}

fn millis(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX / 2)
}
