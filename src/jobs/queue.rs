//! The queue's rules on top of the job table.

use super::compute::problem_json;
use super::{JobOutcome, JobSignals};
use crate::release::facts::{facts_at_end, failure_facts};
use crate::release::{self, CheckStateChange};
use crate::store::{
    Exhausted, Expired, JobResult, JobRow, Lease, NewJob, Result, Store, Tx, job_sources, jobs,
    leases, networks, parameter_sets, robots, verifications,
};
use crate::wire::Problem;
use crate::wire::verification::Verification;

/// Maximum number of waiting jobs of one robot: days of work for all workers.
pub const MAX_WAITING_JOBS_PER_ROBOT: i64 = 10_000;

/// Posts a job in the caller's transaction. After the commit, call [`JobSignals::job_enqueued`].
pub async fn enqueue(tx: &mut Tx, new: &NewJob) -> Result<JobRow> {
    jobs::insert(tx, new, Some(MAX_WAITING_JOBS_PER_ROBOT)).await
}

/// Cancels a job (see [`jobs::cancel`]) and signals its worker and its listeners.
pub async fn cancel(store: &Store, signals: &JobSignals, job_id: &str, by: &str) -> Result<JobRow> {
    let mut tx = store.begin().await?;
    tx.act_as(by);
    let job = jobs::cancel(&mut tx, job_id).await?;
    tx.commit().await?;
    signals.job_cancel_requested(job_id);
    Ok(job)
}

/// How an attempt at a job ends.
#[derive(Debug)]
pub enum AttemptEnd {
    /// With its results. If cancellation was requested, the job is cancelled and no result is stored.
    Finished(Box<JobOutcome>),
    /// As failed, with this problem.
    Failed(Box<Problem>),
    /// As cancelled.
    Cancelled,
    /// The job is queued again, and the attempt does not count.
    HandedBack,
    /// The computation panicked or took too long, or the inputs cannot be read. The attempt counts; [`expire`] decides whether there is another.
    GaveUp,
    /// The lease is lost: nothing is written.
    LeaseLost,
}

/// Ends an attempt in one transaction. If the lease is lost, nothing is stored.
pub async fn end(store: &Store, lease: &Lease, end: &AttemptEnd) -> Result<()> {
    if matches!(end, AttemptEnd::LeaseLost) {
        return Ok(());
    }
    let mut tx = store.begin().await?;
    match end {
        AttemptEnd::Finished(outcome) => finish(&mut tx, lease, outcome).await?,
        AttemptEnd::Failed(problem) => fail(&mut tx, lease, problem).await?,
        AttemptEnd::Cancelled => leases::cancelled(&mut tx, lease).await?,
        AttemptEnd::HandedBack => leases::hand_back(&mut tx, lease).await?,
        AttemptEnd::GaveUp => leases::give_up(&mut tx, lease).await?,
        AttemptEnd::LeaseLost => {}
    }
    tx.commit().await
}

async fn finish(tx: &mut Tx, lease: &Lease, outcome: &JobOutcome) -> Result<()> {
    if outcome.verification.is_some() {
        // Locks the robot, because releases of the same robot count its verifications.
        robots::lock_of_job(tx, &lease.job_id).await?;
    }
    let result = JobResult {
        report_json: &outcome.report_json,
        summary_json: &outcome.summary_json,
        convergence_json: &outcome.convergence_json,
        result_sha256: &outcome.result_sha256,
    };
    if !leases::succeed(tx, lease, &result).await? {
        return Ok(());
    }
    if let Some(parameter_set) = &outcome.parameter_set {
        parameter_sets::insert(tx, &lease.job_id, parameter_set).await?;
    }
    if let Some(found) = &outcome.verification {
        record_facts(tx, &lease.job_id, found).await?;
    }
    // The residual network is stored first: lists are newest first, and clients take the first network of a job for `network_id`.
    if let Some(network) = &outcome.residual_network {
        networks::insert_residual(tx, &lease.job_id, network).await?;
        job_sources::insert_residual(tx, &lease.job_id).await?;
    }
    if let Some(network) = &outcome.network {
        networks::insert(tx, &lease.job_id, network).await?;
    }
    Ok(())
}

/// Fails a job. If the reason is that its points do not fit one robot, this is also recorded as a fact about the robot.
async fn fail(tx: &mut Tx, lease: &Lease, problem: &Problem) -> Result<()> {
    robots::lock_of_job(tx, &lease.job_id).await?;
    let misfit_seq = verifications::robot_counters_of_job(tx, &lease.job_id)
        .await?
        .misfit_seq;
    let found = failure_facts(&problem.code, misfit_seq);
    if leases::fail(tx, lease, &problem_json(problem)).await?
        && let Some(found) = &found
    {
        record_facts(tx, &lease.job_id, found).await?;
    }
    Ok(())
}

/// Stores a job's facts about a parameter set, and the change of the robot's state that follows from them. The transaction must have locked the
/// robot's row.
pub async fn record_facts(tx: &mut Tx, job_id: &str, found: &Verification) -> Result<()> {
    let misfit_seq = verifications::robot_counters_of_job(tx, job_id)
        .await?
        .misfit_seq;
    let found = facts_at_end(found, misfit_seq);
    let Some(row) = verifications::insert(tx, job_id, &found).await? else {
        return Ok(());
    };
    match release::check_state_change(&row.found) {
        Some(CheckStateChange::Begins) => {
            robots::begin_check(tx, &row.robot_id, job_id, row.seq).await
        }
        Some(CheckStateChange::Ends) => robots::end_check(tx, &row.robot_id, job_id).await,
        None => Ok(()),
    }
}

/// Requeues or fails jobs whose leases have expired, and signals their listeners.
pub async fn expire(store: &Store, max_attempts: u32, signals: &JobSignals) -> Result<Expired> {
    let problem = |detail| problem_json(&Problem::new(500, "attempts_exhausted", detail));
    let attempts = match max_attempts {
        1 => "the computation".to_owned(),
        n => format!("each of {n} attempts at this computation"),
    };
    let exhausted = Exhausted {
        by_attempts_json: problem(format!(
            "{attempts} failed or did not end in time, and the server's log has the cause. Many points take long: identify from fewer, with least \
             squares or without corrections"
        )),
        by_deaths_json: problem(format!(
            "the process died {} times while it computed this job alone, often for want of memory: the server's log has the cause. Identify from \
             fewer points",
            leases::MAX_DEATHS_ALONE
        )),
    };
    let expired = leases::expire(store, i64::from(max_attempts), &exhausted).await?;
    for _ in &expired.queued {
        signals.job_enqueued();
    }
    for job_id in expired
        .queued
        .iter()
        .chain(&expired.failed)
        .chain(&expired.cancelled)
    {
        signals.job_changed(job_id);
    }
    Ok(expired)
}
