//! One worker, one job.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinError, JoinHandle, JoinSet};
use tokio::time::{Instant, timeout};

use super::heartbeat::{Beat, Control, Drain, KeptLease, Stop, reached};
use super::{Compute, JobFailure, JobInputs, JobOutcome, JobSignals, queue};
use crate::store::{Conflict, Error, Lease, Result, Store, leases};
use crate::wire::Problem;

/// A computation that goes on though its job is over, and since when.
struct Deaf {
    thread: JoinHandle<()>,
    begun: Instant,
}

/// A job that is being computed, for whoever ends it: the thread that computes it, or its worker where that thread does not come to its end.
struct Attempt {
    store: Store,
    lease: Lease,
    control: Arc<Control>,
    beat: AbortHandle,
    signals: JobSignals,
    is_taken: AtomicBool,
}

/// The worker's part in an attempt. Dropped, nobody ends the attempt: its lease runs out.
struct Watched(Arc<Attempt>);

impl Drop for Watched {
    fn drop(&mut self) {
        self.0.take();
    }
}

const LEFT_TO_ITSELF: &str =
    "a computation takes longer than a job may, and does not stop; its thread is left to itself";

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
        WorkerContext {
            owner,
            compute,
            lease,
            longest: Duration::MAX,
            signals,
            drain: Arc::new(watch::Sender::new(Drain::No)),
        }
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
    let (lease, control) = (
        Lease::of(&job, &context.owner),
        Arc::new(Control::default()),
    );
    let until = Instant::now() + context.lease;
    // What a job names was committed before it was posted, so it is read while the claim is committed. Nothing is computed before that is
    // certain, or a job that ends the process would be begun again and again.
    let mut reading = JoinSet::new();
    reading.spawn({
        let store = store.clone();
        async move { JobInputs::of(&store, job).await }
    });
    tx.commit().await?;
    tracing::info!(
        job_id = lease.job_id,
        owner = lease.owner,
        attempt = lease.attempt,
        "job begun"
    );
    context.signals.job_changed(&lease.job_id);
    let kept = keep(store, context, &lease, &control);
    let read = reading
        .join_next()
        .await
        .and_then(std::result::Result::ok)
        .and_then(Result::ok);
    let read = inputs(store, context, &lease, (read, until), &control).await;
    let (beat, signals, is_taken) = (kept.beat(), context.signals.clone(), AtomicBool::new(false));
    let attempt = Watched(Arc::new(Attempt {
        store: store.clone(),
        lease,
        control,
        beat,
        signals,
        is_taken,
    }));
    let deaf = match read {
        Ok(inputs) => compute(context, &attempt.0, inputs).await,
        Err(ended) => {
            attempt.0.end(ended).await;
            None
        }
    };
    drop(kept);
    let job_id = attempt.0.lease.job_id.clone();
    if let Some(deaf) = deaf {
        wait_for(context, &job_id, deaf).await;
    }
    Ok(Some(job_id))
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

fn keep(
    store: &Store,
    context: &WorkerContext,
    lease: &Lease,
    control: &Arc<Control>,
) -> KeptLease {
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
        if timeout(RETRY_AFTER, reached(&mut drain, Drain::Stop))
            .await
            .is_ok()
        {
            return Err(Ended::HandedBack);
        }
    }
}

/// Computes a job and ends it; of one that was cancelled while its computation does not look whether it should stop, gives the thread that is
/// still at it.
async fn compute(
    context: &WorkerContext,
    attempt: &Arc<Attempt>,
    inputs: JobInputs,
) -> Option<Deaf> {
    let begun = Instant::now();
    let (function, theirs, runtime) = (context.compute, Arc::clone(attempt), Handle::current());
    let mut thread = tokio::task::spawn_blocking(move || {
        let result = catch_unwind(AssertUnwindSafe(|| {
            function(&inputs, &mut |progress| theirs.control.report(progress))
        }));
        if let Err(panic) = &result {
            log_panic(&theirs.lease.job_id, &**panic);
        }
        if theirs.take() {
            // here, where the result is: to hand it to the worker's task would mean to wait until another thread has woken
            runtime.block_on(theirs.end(theirs.ended(result)));
        }
    });
    let mut drain = context.drain.subscribe();
    let deaf = tokio::select! {
        result = &mut thread => return came_to_its_end(attempt, result),
        () = reached(&mut drain, Drain::Abandon) => Ended::HandedBack,
        () = deaf_after(context.longest, &attempt.control) => Ended::GaveUp,
        () = deaf_to_its_cancellation(&attempt.control) => Ended::Cancelled,
    };
    if !attempt.take() {
        return came_to_its_end(attempt, thread.await);
    }
    let job_id = &attempt.lease.job_id;
    let is_waited_for = matches!(deaf, Ended::Cancelled);
    match deaf {
        Ended::GaveUp => tracing::error!(job_id, "{LEFT_TO_ITSELF}"),
        Ended::Cancelled => tracing::info!(
            job_id,
            "a cancelled job's computation has not stopped yet; its worker waits for that"
        ),
        _ => {}
    }
    attempt.end(deaf).await;
    is_waited_for.then_some(Deaf { thread, begun })
}

/// The thread has ended its job. If it could not, the lease runs out.
fn came_to_its_end(attempt: &Attempt, result: std::result::Result<(), JoinError>) -> Option<Deaf> {
    if let Err(error) = result {
        tracing::error!(job_id = attempt.lease.job_id, %error, "the thread of a computation broke; the job's lease will run out");
    }
    None
}

/// Waits for a computation that nobody waits for any more, as long as it may take: two at a time would be more than a worker may compute.
async fn wait_for(context: &WorkerContext, job_id: &str, Deaf { thread, begun }: Deaf) {
    let left = context
        .longest
        .saturating_sub(begun.elapsed())
        .saturating_add(STOP_WITHIN);
    let mut drain = context.drain.subscribe();
    tokio::select! {
        _ = thread => {}
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

impl Attempt {
    /// True for the first who asks: this attempt is his to end.
    fn take(&self) -> bool {
        !self.is_taken.swap(true, Ordering::AcqRel)
    }

    /// What the end of its computation means.
    fn ended(
        &self,
        result: std::thread::Result<std::result::Result<JobOutcome, JobFailure>>,
    ) -> Ended {
        let job_id = &self.lease.job_id;
        match result {
            Ok(Ok(outcome)) => Ended::Finished(Box::new(outcome)),
            Ok(Err(JobFailure::Failed { problem_json })) => Ended::Failed(problem_json),
            Ok(Err(JobFailure::Cancelled)) => match self.control.stopped() {
                Some(Stop::Cancelled) => Ended::Cancelled,
                Some(Stop::ShuttingDown) => Ended::HandedBack,
                Some(Stop::LeaseLost) => Ended::LeftToItsLease,
                Some(Stop::TooLong) => {
                    tracing::error!(
                        job_id,
                        "a computation was stopped: it took longer than a job may"
                    );
                    Ended::GaveUp
                }
                None => Ended::Failed(internal(job_id, "it stopped without being told to")),
            },
            Err(_) => Ended::GaveUp,
        }
    }

    /// Ends the job, as often as it takes while the lease holds, and tells whom it concerns.
    async fn end(&self, mut ended: Ended) {
        let Attempt { store, lease, .. } = self;
        let is_ours = || !self.beat.is_finished();
        loop {
            match try_to_end(store, lease, &ended).await {
                Ok(()) => break,
                Err(Error::Conflict(Conflict::LeaseLost)) => {
                    tracing::warn!(
                        job_id = lease.job_id,
                        owner = lease.owner,
                        attempt = lease.attempt,
                        "the job is not ours any more; nothing was written"
                    );
                    break;
                }
                Err(error) if error.is_unavailable() && is_ours() => {
                    tracing::warn!(job_id = lease.job_id, error = %error.cause(), "the job could not be ended; trying again");
                    tokio::time::sleep(RETRY_AFTER).await;
                }
                Err(error) if matches!(ended, Ended::Finished(_)) && is_ours() => {
                    tracing::error!(job_id = lease.job_id, error = %error.cause(), "the result cannot be stored");
                    ended =
                        Ended::Failed(internal(&lease.job_id, "its result could not be stored"));
                }
                Err(error) => {
                    tracing::error!(job_id = lease.job_id, error = %error.cause(), "the job cannot be ended; its lease will run out");
                    break;
                }
            }
        }
        self.beat.abort();
        self.signals.job_changed(&lease.job_id);
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
    queue::problem_json(&Problem::new(
        500,
        "internal",
        "the computation broke; the server's log says why",
    ))
}

fn log_panic(job_id: &str, panic: &(dyn Any + Send)) {
    let text = panic.downcast_ref::<&str>().copied();
    let what = text
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("(no message)");
    tracing::error!(job_id, what, "a computation panicked");
}
