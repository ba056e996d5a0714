//! One worker, one job: claims it, reads its inputs, computes it on a blocking thread, and ends it.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::{JoinError, JoinHandle};
use tokio::time::{Instant, timeout};

use super::heartbeat::{
    Control, LeaseRenewal, RenewedLease, ShutdownStage, StopReason, shutdown_reached,
};
use super::queue::{self, AttemptEnd};
use super::run_alone::{Permit, RunAlone};
use super::{Compute, JobFailure, JobInputs, JobOutcome, JobSignals};
use crate::store::leases::{self, Eligible};
use crate::store::{Conflict, Error, JobRow, Lease, Result, Store, jobs};
use crate::wire::Problem;

const UNRESPONSIVE: &str =
    "a computation exceeded its time limit and does not stop; its thread is left running";

/// Settings of a worker.
#[derive(Clone, Debug)]
pub struct WorkerContext {
    /// Unique name of the worker.
    pub owner: String,
    /// The computation of a job.
    pub compute: Compute,
    /// Duration of a lease.
    pub lease: Duration,
    /// Longest duration of one attempt.
    pub max_duration: Duration,
    /// Signals that the worker sends and receives.
    pub signals: JobSignals,
    pub(super) shutdown_stage: Arc<watch::Sender<ShutdownStage>>,
    /// Shared by the workers of a process.
    pub(super) run_alone: Arc<RunAlone>,
}

impl WorkerContext {
    /// A worker with a new name and no limit on the duration of an attempt.
    pub fn new(compute: Compute, lease: Duration, signals: JobSignals) -> WorkerContext {
        let owner = format!("worker_{}", uuid::Uuid::now_v7().simple());
        WorkerContext {
            owner,
            compute,
            lease,
            max_duration: Duration::MAX,
            signals,
            shutdown_stage: Arc::new(watch::Sender::new(ShutdownStage::Running)),
            run_alone: Arc::new(RunAlone::new(lease)),
        }
    }
}

/// Time for a computation to stop after it was asked to.
pub(super) const COMPUTATION_STOP_TIMEOUT: Duration = Duration::from_secs(1);
/// Time after which a cancelled job ends even if its computation has not stopped.
const CANCEL_TIMEOUT: Duration = Duration::from_millis(250);
/// Retry interval while the database is unavailable.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// A claimed job, the end of its first lease, and the permit to run it.
struct Claimed {
    job: JobRow,
    until: Instant,
    permit: Permit,
}

/// Claims the next job that this process may run now. Suspects come last, unless they have waited long enough.
async fn claim_next(store: &Store, context: &WorkerContext) -> Result<Option<Claimed>> {
    let run_alone = &context.run_alone;
    let mut shutdown_stage = context.shutdown_stage.subscribe();
    if run_alone.suspect_is_due() {
        let permit = tokio::select! {
            biased;
            () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming) => return Ok(None),
            permit = run_alone.alone() => permit,
        };
        // Checked again: another worker of this process may have run the suspect meanwhile.
        if run_alone.suspect_is_due() {
            run_alone.suspect_started();
            let claimed = claim(store, context, Eligible::Suspect, permit).await?;
            if claimed.is_some() {
                return Ok(claimed);
            }
        }
    }
    let permit = tokio::select! {
        biased;
        () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming) => return Ok(None),
        permit = run_alone.shared() => permit,
    };
    let claimed = claim(store, context, Eligible::Unsuspected, permit).await?;
    if claimed.is_some() || !jobs::any_suspect_queued(store).await? {
        return Ok(claimed);
    }
    match run_alone.try_alone().await {
        Some(permit) => claim(store, context, Eligible::Suspect, permit).await,
        None => Ok(None),
    }
}

async fn claim(
    store: &Store,
    context: &WorkerContext,
    eligible: Eligible,
    permit: Permit,
) -> Result<Option<Claimed>> {
    let mut tx = store.begin().await?;
    let Some(job) = leases::claim_in(&mut tx, eligible, &context.owner, context.lease).await?
    else {
        tx.rollback().await?;
        return Ok(None);
    };
    let until = Instant::now() + context.lease;
    // Commits before the computation. Otherwise a job that kills its process would be retried without end.
    tx.commit().await?;
    tracing::info!(
        job_id = job.id,
        owner = context.owner,
        attempt = job.attempt,
        alone = matches!(permit, Permit::Alone(_)),
        "job begun"
    );
    Ok(Some(Claimed { job, until, permit }))
}

/// Claims the next job, computes it and ends it. Returns `None` if no job waits.
///
/// # Errors
/// [`Error::Database`] if no job could be claimed. Later errors end the job, and are not returned.
pub async fn run_next_job(store: &Store, context: &WorkerContext) -> Result<Option<String>> {
    let Some(claimed) = claim_next(store, context).await? else {
        return Ok(None);
    };
    let Claimed {
        job,
        until,
        permit: _permit,
    } = claimed;
    let job_id = job.id.clone();
    let lease = Lease::new(&job, &context.owner);
    context.signals.job_changed(&job_id);
    let attempt = Attempt {
        store,
        context,
        heartbeat: RenewedLease::new(LeaseRenewal {
            store: store.clone(),
            lease: lease.clone(),
            duration: context.lease,
            control: Arc::default(),
            signals: context.signals.clone(),
            cancellations: context.signals.cancellations(&job_id),
            shutdown_stage: context.shutdown_stage.subscribe(),
        }),
        lease,
        begun: Instant::now(),
    };
    let unresponsive = match attempt.inputs(&job, until).await {
        Ok(inputs) => attempt.compute(inputs).await,
        Err(ended) => {
            attempt.end(ended).await;
            None
        }
    };
    drop(attempt);
    if let Some(computation) = unresponsive {
        computation.wait(context, &job_id).await;
    }
    Ok(Some(job_id))
}

/// One attempt at a job. If it is dropped before its end, the lease expires.
struct Attempt<'a> {
    store: &'a Store,
    context: &'a WorkerContext,
    lease: Lease,
    heartbeat: RenewedLease,
    begun: Instant,
}

/// A computation that still runs although its job has ended.
struct Unresponsive {
    thread: JoinHandle<Computed>,
    begun: Instant,
}

type Computed = std::result::Result<JobOutcome, JobFailure>;

impl Attempt<'_> {
    fn control(&self) -> &Arc<Control> {
        self.heartbeat.control()
    }

    /// Time until the attempt exceeds its longest duration.
    fn time_left(&self) -> Duration {
        let max_duration = self.context.max_duration;
        max_duration.saturating_sub(self.begun.elapsed())
    }

    /// Reads the job's inputs, with retries for the duration of a lease. If the database stays unavailable, the job goes back to the queue and the
    /// attempt does not count. A request to stop is heard while the inputs are read.
    async fn inputs(
        &self,
        job: &JobRow,
        until: Instant,
    ) -> std::result::Result<JobInputs, AttemptEnd> {
        let mut shutdown_stage = self.context.shutdown_stage.subscribe();
        loop {
            let loaded = async {
                let inputs = JobInputs::load_for(self.store, job.clone()).await?;
                inputs.with_known_uploads(self.store).await
            };
            let loaded = tokio::select! {
                biased;
                reason = self.control().stopped() => {
                    return Err(match reason {
                        // The attempt does not count. If another worker has the job, the fencing condition refuses this write.
                        StopReason::LeaseLost => AttemptEnd::HandedBack,
                        reason => self.end_of_stopped(reason),
                    });
                }
                () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopComputing) => {
                    return Err(AttemptEnd::HandedBack);
                }
                loaded = loaded => loaded,
                () = tokio::time::sleep(self.time_left()) => {
                    return Err(self.end_of_stopped(StopReason::TooLong));
                }
            };
            let error = match loaded {
                Ok(inputs) => return Ok(inputs),
                Err(error) => error,
            };
            if !error.is_unavailable() {
                tracing::error!(job_id = job.id, error = %error.cause(), "the job's inputs cannot be read");
                return Err(AttemptEnd::GaveUp);
            }
            if Instant::now() >= until {
                // If the lease has expired meanwhile, the fencing condition refuses this write.
                return Err(AttemptEnd::HandedBack);
            }
            tracing::warn!(job_id = job.id, error = %error.cause(), "the job's inputs could not be read; trying again");
            if timeout(
                RETRY_AFTER,
                shutdown_reached(&mut shutdown_stage, ShutdownStage::StopComputing),
            )
            .await
            .is_ok()
            {
                return Err(AttemptEnd::HandedBack);
            }
        }
    }

    /// Computes the job and ends it. Returns the computation of a cancelled job that has not stopped yet.
    async fn compute(&self, inputs: JobInputs) -> Option<Unresponsive> {
        let control = self.control();
        let (function, thread_control) = (self.context.compute, Arc::clone(control));
        let mut thread = tokio::task::spawn_blocking(move || {
            function(&inputs, &mut |progress| thread_control.report(progress))
        });
        let mut shutdown_stage = self.context.shutdown_stage.subscribe();
        let ended = tokio::select! {
            result = &mut thread => {
                self.end(self.ended(result)).await;
                return None;
            }
            () = shutdown_reached(&mut shutdown_stage, ShutdownStage::Abandon) => AttemptEnd::HandedBack,
            () = time_limit_exceeded(self.time_left(), control) => AttemptEnd::GaveUp,
            () = cancelled_and_unresponsive(control) => AttemptEnd::Cancelled,
        };
        let job_id = &self.lease.job_id;
        let is_waited_for = matches!(ended, AttemptEnd::Cancelled);
        match ended {
            AttemptEnd::GaveUp => tracing::error!(job_id, "{UNRESPONSIVE}"),
            AttemptEnd::Cancelled => tracing::info!(
                job_id,
                "the computation of a cancelled job has not stopped yet; its worker waits for it"
            ),
            _ => {}
        }
        self.end(ended).await;
        is_waited_for.then_some(Unresponsive {
            thread,
            begun: self.begun,
        })
    }

    /// Maps the computation's result to the end of the job.
    fn ended(&self, result: std::result::Result<Computed, JoinError>) -> AttemptEnd {
        let job_id = &self.lease.job_id;
        match result {
            Ok(Ok(outcome)) => AttemptEnd::Finished(Box::new(outcome)),
            Ok(Err(JobFailure::Failed(problem))) => AttemptEnd::Failed(problem),
            Ok(Err(JobFailure::Cancelled)) => match self.control().stop_reason() {
                Some(reason) => self.end_of_stopped(reason),
                None => {
                    AttemptEnd::Failed(internal(job_id, "it stopped although nobody requested it"))
                }
            },
            Err(error) => {
                log_panic(job_id, error);
                AttemptEnd::GaveUp
            }
        }
    }

    /// The end of an attempt that was asked to stop.
    fn end_of_stopped(&self, reason: StopReason) -> AttemptEnd {
        match reason {
            StopReason::Cancelled => AttemptEnd::Cancelled,
            StopReason::ShuttingDown => AttemptEnd::HandedBack,
            StopReason::LeaseLost => AttemptEnd::LeaseLost,
            StopReason::TooLong => {
                tracing::error!(
                    job_id = self.lease.job_id,
                    "the attempt was stopped: it exceeded the longest duration of an attempt"
                );
                AttemptEnd::GaveUp
            }
        }
    }

    /// Ends the job, with retries while the lease holds, and signals its listeners.
    async fn end(&self, mut ended: AttemptEnd) {
        let (store, lease) = (self.store, &self.lease);
        let lease_holds = || !self.heartbeat.is_lost();
        loop {
            match queue::end(store, lease, &ended).await {
                Ok(()) => break,
                Err(Error::Conflict(Conflict::LeaseLost)) => {
                    tracing::warn!(
                        job_id = lease.job_id,
                        owner = lease.owner,
                        attempt = lease.attempt,
                        "the lease was lost; this attempt writes nothing more"
                    );
                    break;
                }
                Err(error) if error.is_unavailable() && lease_holds() => {
                    tracing::warn!(job_id = lease.job_id, error = %error.cause(), "the job could not be ended; trying again");
                    tokio::time::sleep(RETRY_AFTER).await;
                }
                Err(error) if matches!(ended, AttemptEnd::Finished(_)) && lease_holds() => {
                    tracing::error!(job_id = lease.job_id, error = %error.cause(), "the result cannot be stored");
                    ended = AttemptEnd::Failed(internal(
                        &lease.job_id,
                        "its result could not be stored",
                    ));
                }
                Err(error) => {
                    tracing::error!(job_id = lease.job_id, error = %error.cause(), "the job cannot be ended; its lease will expire");
                    break;
                }
            }
        }
        self.heartbeat.stop();
        self.context.signals.job_changed(&lease.job_id);
    }
}

impl Unresponsive {
    /// Waits for the computation, at most until its longest duration: a worker computes one job at a time.
    async fn wait(self, context: &WorkerContext, job_id: &str) {
        let left = context
            .max_duration
            .saturating_sub(self.begun.elapsed())
            .saturating_add(COMPUTATION_STOP_TIMEOUT);
        let mut shutdown_stage = context.shutdown_stage.subscribe();
        tokio::select! {
            _ = self.thread => {}
            () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming) => {}
            () = tokio::time::sleep(left) => tracing::error!(job_id, "{UNRESPONSIVE}"),
        }
    }
}

/// Asks a computation to stop when its time is over; resolves if it has not stopped shortly afterwards. The thread cannot be ended, but the
/// caller can end the attempt.
async fn time_limit_exceeded(time_left: Duration, control: &Control) {
    tokio::time::sleep(time_left).await;
    control.stop(StopReason::TooLong);
    tokio::time::sleep(COMPUTATION_STOP_TIMEOUT).await;
}

/// Resolves if the computation of a cancelled job has not stopped in time. The job then ends without waiting for it.
async fn cancelled_and_unresponsive(control: &Control) {
    control.cancelled().await;
    tokio::time::sleep(CANCEL_TIMEOUT).await;
}

/// The problem of a computation that failed internally; the cause goes to the log only.
fn internal(job_id: &str, what: &str) -> Box<Problem> {
    tracing::error!(job_id, what, "a computation failed");
    Box::new(Problem::new(
        500,
        "internal",
        "the computation failed; the server's log has the cause under the job's id",
    ))
}

fn log_panic(job_id: &str, error: JoinError) {
    let panic = error.try_into_panic().ok();
    let text = panic.as_ref().and_then(|panic| {
        let text = panic.downcast_ref::<&str>().copied();
        text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
    });
    let what = text.unwrap_or("(no message)");
    tracing::error!(job_id, what, "a computation panicked");
}
