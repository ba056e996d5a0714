//! One worker, one job.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};

use super::heartbeat::{Beat, Control, Drain, KeptLease, Stop, reached};
use super::{Compute, JobFailure, JobInputs, JobOutcome, JobSignals, queue};
use crate::store::{Conflict, Error, Lease, Result, Store, leases};
use crate::wire::Problem;

/// A computation that goes on though its job is over, and since when.
struct Deaf {
    thread: JoinHandle<std::thread::Result<std::result::Result<JobOutcome, JobFailure>>>,
    begun: Instant,
}

const LEFT_TO_ITSELF: &str = "a computation takes longer than a job may, and does not stop; its thread is left to itself";

/// How a worker works.
#[derive(Clone, Debug)]
pub struct WorkerContext {
    /// Its name; never used before.
    pub owner: String,
    /// What it computes.
    pub compute: Compute,
    /// How long it has a job without renewing.
    pub lease: Duration,
    /// How long one attempt may compute.
    pub longest: Duration,
    /// Whom it tells.
    pub signals: JobSignals,
    pub(super) drain: Arc<watch::Sender<Drain>>,
}

impl WorkerContext {
    /// A worker with a new name, whose attempts may take as long as they like.
    pub fn new(compute: Compute, lease: Duration, signals: JobSignals) -> WorkerContext {
        let owner = format!("worker_{}", uuid::Uuid::now_v7().simple());
        WorkerContext { owner, compute, lease, longest: Duration::MAX, signals, drain: Arc::new(watch::Sender::new(Drain::No)) }
    }
}

/// How an attempt ended.
enum Ended {
    Finished(Box<JobOutcome>),
    Failed(String),
    Cancelled,
    HandedBack,
    /// It panicked or did not come to an end: another attempt, if there is one left.
    GaveUp,
    /// The job is not ours any more, or its inputs cannot be read: its lease says what happens next.
    LeftToItsLease,
}

/// How long a computation that was told to stop may take to do so.
pub(super) const STOP_WITHIN: Duration = Duration::from_secs(1);
/// How long a computation may take to stop before its job is ended as cancelled without it.
const CANCELLED_WITHIN: Duration = Duration::from_millis(250);
/// While the database is away, inputs are asked for and an ended job is offered again after this, as long as the lease holds.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// Claims the next job, computes it and ends it; none if no job waits.
///
/// # Errors
/// [`Error::Database`] if nothing could be claimed. What happens afterwards is the job's, not the caller's.
pub async fn run_next_job(store: &Store, context: &WorkerContext) -> Result<Option<String>> {
    let mut tx = store.begin().await?;
    let Some(job) = leases::claim_in(&mut tx, &context.owner, context.lease).await? else {
        tx.rollback().await?;
        return Ok(None);
    };
    let (lease, control) = (Lease::of(&job, &context.owner), Arc::new(Control::default()));
    let until = Instant::now() + context.lease;
    // What a job names was committed before it was posted, so it is read while the claim is committed. Nothing is computed before that is
    // certain, or a job that ends the process would be begun again and again.
    let begin = async {
        tx.commit().await?;
        tracing::info!(job_id = lease.job_id, owner = lease.owner, attempt = lease.attempt, "job begun");
        context.signals.job_changed(&lease.job_id);
        Ok::<_, Error>(keep(store, context, &lease, &control))
    };
    let (kept, read) = tokio::join!(begin, JobInputs::of(store, job));
    let kept = kept?;
    let (ended, deaf) = match inputs(store, context, &lease, (read.ok(), until), &control).await {
        Ok(inputs) => compute(context, inputs, &control).await,
        Err(ended) => (ended, None),
    };
    end(store, &lease, &kept, ended).await;
    drop(kept);
    context.signals.job_changed(&lease.job_id);
    if let Some(deaf) = deaf {
        wait_for(context, &lease.job_id, deaf).await;
    }
    Ok(Some(lease.job_id))
}

/// Runs jobs until none waits: how tests step a worker.
///
/// # Errors
/// As [`run_next_job`].
pub async fn run_pending_jobs(store: &Store, context: &WorkerContext) -> Result<Vec<String>> {
    let mut done = Vec::new();
    while let Some(job_id) = run_next_job(store, context).await? {
        done.push(job_id);
    }
    Ok(done)
}

fn keep(store: &Store, context: &WorkerContext, lease: &Lease, control: &Arc<Control>) -> KeptLease {
    KeptLease::new(Beat {
        store: store.clone(),
        lease: lease.clone(),
        duration: context.lease,
        control: Arc::clone(control),
        signals: context.signals.clone(),
        cancellations: context.signals.cancellations(&lease.job_id),
        drain: context.drain.subscribe(),
    })
}

/// The job's inputs: those read already, or read as often as it takes for the time of a lease. What the database could not give is not the
/// job's fault: it is handed back and uses up no attempt.
async fn inputs(
    store: &Store,
    context: &WorkerContext,
    lease: &Lease,
    (read, until): (Option<JobInputs>, Instant),
    control: &Control,
) -> std::result::Result<JobInputs, Ended> {
    if let Some(inputs) = read {
        return Ok(inputs);
    }
    let mut drain = context.drain.subscribe();
    loop {
        let error = match JobInputs::load(store, &lease.job_id).await {
            Ok(inputs) => return Ok(inputs),
            Err(error) => error,
        };
        if !error.is_unavailable() {
            tracing::error!(job_id = lease.job_id, error = %error.cause(), "the job's inputs cannot be read");
            return Err(Ended::LeftToItsLease);
        }
        match control.stopped() {
            Some(Stop::Cancelled) => return Err(Ended::Cancelled),
            None if Instant::now() < until => {}
            // Where the lease ran out meanwhile, handing it back changes nothing that is not this worker's any more.
            _ => return Err(Ended::HandedBack),
        }
        tracing::warn!(job_id = lease.job_id, error = %error.cause(), "the job's inputs could not be read; trying again");
        if timeout(RETRY_AFTER, reached(&mut drain, Drain::Stop)).await.is_ok() {
            return Err(Ended::HandedBack);
        }
    }
}

/// How the computation ended; of a job that was cancelled while it does not look whether it should stop, with the thread that is still at it.
async fn compute(context: &WorkerContext, inputs: JobInputs, control: &Arc<Control>) -> (Ended, Option<Deaf>) {
    let begun = Instant::now();
    let (function, theirs, job_id) = (context.compute, Arc::clone(control), inputs.job.id.clone());
    let mut thread =
        tokio::task::spawn_blocking(move || catch_unwind(AssertUnwindSafe(|| function(&inputs, &mut |progress| theirs.report(progress)))));
    let mut drain = context.drain.subscribe();
    let result = tokio::select! {
        result = &mut thread => result,
        () = reached(&mut drain, Drain::Abandon) => return (Ended::HandedBack, None),
        () = deaf_after(context.longest, control) => {
            tracing::error!(job_id, "{LEFT_TO_ITSELF}");
            return (Ended::GaveUp, None);
        }
        () = deaf_to_its_cancellation(control) => {
            tracing::info!(job_id, "a cancelled job's computation has not stopped yet; its worker waits for that");
            return (Ended::Cancelled, Some(Deaf { thread, begun }));
        }
    };
    let ended = match result {
        Ok(Ok(Ok(outcome))) => Ended::Finished(Box::new(outcome)),
        Ok(Ok(Err(JobFailure::Failed { problem_json }))) => Ended::Failed(problem_json),
        Ok(Ok(Err(JobFailure::Cancelled))) => match control.stopped() {
            Some(Stop::Cancelled) => Ended::Cancelled,
            Some(Stop::ShuttingDown) => Ended::HandedBack,
            Some(Stop::LeaseLost) => Ended::LeftToItsLease,
            Some(Stop::TooLong) => {
                tracing::error!(job_id, longest = ?context.longest, "a computation was stopped: it took longer than a job may");
                Ended::GaveUp
            }
            None => Ended::Failed(internal(&job_id, "it stopped without being told to")),
        },
        Ok(Err(panic)) => {
            log_panic(&job_id, &*panic);
            Ended::GaveUp
        }
        // The runtime goes down: the lease runs out.
        Err(_) => Ended::LeftToItsLease,
    };
    (ended, None)
}

/// Waits for a computation that nobody waits for any more, as long as it may take: two at a time would be more than a worker may compute.
async fn wait_for(context: &WorkerContext, job_id: &str, Deaf { thread, begun }: Deaf) {
    let left = context.longest.saturating_sub(begun.elapsed()).saturating_add(STOP_WITHIN);
    let mut drain = context.drain.subscribe();
    tokio::select! {
        ended = thread => {
            if let Ok(Err(panic)) = ended {
                log_panic(job_id, &*panic);
            }
        }
        () = reached(&mut drain, Drain::Finish) => {}
        () = tokio::time::sleep(left) => tracing::error!(job_id, "{LEFT_TO_ITSELF}"),
    }
}

/// Tells a computation to stop when its time is over; resolves if it has not stopped shortly afterwards. A thread cannot be ended from
/// outside, but its job can, and nobody waits for it any more.
async fn deaf_after(longest: Duration, control: &Control) {
    tokio::time::sleep(longest).await;
    control.stop(Stop::TooLong);
    tokio::time::sleep(STOP_WITHIN).await;
}

/// Resolves if a computation whose job was cancelled has not stopped soon afterwards. Who cancelled it need not wait for that.
async fn deaf_to_its_cancellation(control: &Control) {
    control.cancelled().await;
    tokio::time::sleep(CANCELLED_WITHIN).await;
}

/// Ends the job, as often as it takes while the lease holds.
async fn end(store: &Store, lease: &Lease, kept: &KeptLease, mut ended: Ended) {
    loop {
        match try_to_end(store, lease, &ended).await {
            Ok(()) => return,
            Err(Error::Conflict(Conflict::LeaseLost)) => {
                tracing::warn!(
                    job_id = lease.job_id,
                    owner = lease.owner,
                    attempt = lease.attempt,
                    "the job is not ours any more; nothing was written"
                );
                return;
            }
            Err(error) if error.is_unavailable() && !kept.is_lost() => {
                tracing::warn!(job_id = lease.job_id, error = %error.cause(), "the job could not be ended; trying again");
                tokio::time::sleep(RETRY_AFTER).await;
            }
            Err(error) if matches!(ended, Ended::Finished(_)) && !kept.is_lost() => {
                tracing::error!(job_id = lease.job_id, error = %error.cause(), "the result cannot be stored");
                ended = Ended::Failed(internal(&lease.job_id, "its result could not be stored"));
            }
            Err(error) => {
                tracing::error!(job_id = lease.job_id, error = %error.cause(), "the job cannot be ended; its lease will run out");
                return;
            }
        }
    }
}

async fn try_to_end(store: &Store, lease: &Lease, ended: &Ended) -> Result<()> {
    match ended {
        Ended::Finished(outcome) => queue::finish(store, lease, outcome).await,
        Ended::Failed(problem_json) => queue::fail(store, lease, problem_json).await,
        Ended::Cancelled => queue::end_cancelled(store, lease).await,
        Ended::HandedBack => queue::hand_back(store, lease).await,
        Ended::GaveUp => queue::give_up(store, lease).await,
        Ended::LeftToItsLease => Ok(()),
    }
}

/// The problem of a computation that broke; the cause is for the log only.
fn internal(job_id: &str, what: &str) -> String {
    tracing::error!(job_id, what, "a computation broke");
    queue::problem_json(&Problem::new(500, "internal", "the computation broke; the server's log says why"))
}

fn log_panic(job_id: &str, panic: &(dyn Any + Send)) {
    let text = panic.downcast_ref::<&str>().copied();
    let what = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("(no message)");
    tracing::error!(job_id, what, "a computation panicked");
}
