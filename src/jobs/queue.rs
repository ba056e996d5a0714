//! The queue's rules on top of the job table.

use super::{JobOutcome, JobSignals};
use crate::store::{
    Expired, JobRow, Lease, NewJob, Result, Store, Tx, jobs, leases, networks, parameter_sets,
    robots,
};
use crate::wire::Problem;

/// How many jobs of one robot may wait: days of work for all workers; a client that posts more has run wild.
pub const MAX_WAITING_JOBS_PER_ROBOT: i64 = 10_000;

/// Posts a job in the caller's transaction. After the commit, tell the workers: [`JobSignals::job_enqueued`].
///
/// # Errors
/// Those of [`jobs::insert`].
pub async fn enqueue(tx: &mut Tx, new: &NewJob) -> Result<JobRow> {
    jobs::insert(tx, new, Some(MAX_WAITING_JOBS_PER_ROBOT)).await
}

/// Cancels a job (see [`jobs::cancel`]) and tells its worker and its listeners at once.
///
/// # Errors
/// Those of [`jobs::cancel`].
pub async fn cancel(store: &Store, signals: &JobSignals, job_id: &str, by: &str) -> Result<JobRow> {
    let mut tx = store.begin().await?;
    tx.act_as(by);
    let job = jobs::cancel(&mut tx, job_id).await?;
    tx.commit().await?;
    signals.job_cancel_requested(job_id);
    Ok(job)
}

/// Ends a job with everything it made, in one transaction: all of it or, if the lease is lost, nothing. One that somebody wanted cancelled
/// before it came to its end is cancelled, and nothing of it is kept.
///
/// # Errors
/// [`crate::store::Conflict::LeaseLost`], [`crate::store::Error::Database`].
pub async fn finish(store: &Store, lease: &Lease, outcome: &JobOutcome) -> Result<()> {
    let mut tx = store.begin().await?;
    if outcome.parameter_set.is_none() {
        // A release that has counted the sessions ends first, or sees this one.
        robots::lock_of_job(&mut tx, &lease.job_id).await?;
    }
    if !leases::succeed(
        &mut tx,
        lease,
        &outcome.report_json,
        &outcome.convergence_json,
        &outcome.result_sha256,
    )
    .await?
    {
        return tx.commit().await;
    }
    if let Some(parameter_set) = &outcome.parameter_set {
        parameter_sets::insert(&mut tx, &lease.job_id, parameter_set).await?;
    }
    // lists are newest first: the network that `network_id` takes is the first of its job
    if let Some(network) = &outcome.residual_network {
        networks::insert_residual(&mut tx, &lease.job_id, network).await?;
    }
    if let Some(network) = &outcome.network {
        networks::insert(&mut tx, &lease.job_id, network).await?;
    }
    tx.commit().await
}

/// Ends a job with problem details.
///
/// # Errors
/// [`crate::store::Conflict::LeaseLost`], [`crate::store::Error::Database`].
pub async fn fail(store: &Store, lease: &Lease, problem_json: &str) -> Result<()> {
    let mut tx = store.begin().await?;
    leases::fail(&mut tx, lease, problem_json).await?;
    tx.commit().await
}

/// Ends a job as cancelled.
///
/// # Errors
/// [`crate::store::Conflict::LeaseLost`], [`crate::store::Error::Database`].
pub async fn end_cancelled(store: &Store, lease: &Lease) -> Result<()> {
    let mut tx = store.begin().await?;
    leases::cancelled(&mut tx, lease).await?;
    tx.commit().await
}

/// Puts a job back for another worker, without counting this attempt.
///
/// # Errors
/// [`crate::store::Conflict::LeaseLost`], [`crate::store::Error::Database`].
pub async fn hand_back(store: &Store, lease: &Lease) -> Result<()> {
    let mut tx = store.begin().await?;
    leases::hand_back(&mut tx, lease).await?;
    tx.commit().await
}

/// Ends the lease of a computation that panicked: this attempt counts, and [`expire`] says what comes next.
///
/// # Errors
/// [`crate::store::Conflict::LeaseLost`], [`crate::store::Error::Database`].
pub async fn give_up(store: &Store, lease: &Lease) -> Result<()> {
    let mut tx = store.begin().await?;
    leases::give_up(&mut tx, lease).await?;
    tx.commit().await
}

/// Takes jobs from workers whose leases ran out, and tells whom it concerns.
///
/// # Errors
/// [`crate::store::Error::Database`].
pub async fn expire(store: &Store, max_attempts: u32, signals: &JobSignals) -> Result<Expired> {
    let detail = format!(
        "{max_attempts} attempts to compute this job ended without a result; each time it broke, or its worker stopped or was cut off"
    );
    let problem = problem_json(&Problem::new(500, "attempts_exhausted", detail));
    let expired = leases::expire(store, i64::from(max_attempts), &problem).await?;
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

pub(super) fn problem_json(problem: &Problem) -> String {
    serde_json::json!(problem).to_string()
}
