//! Renews a worker's lease while it computes, in a separate task.

use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout_at};

use super::progress::{Cancellations, JobSignals};
use crate::store::{Conflict, Error, Lease, Store, leases};
use crate::wire::job_answer::ProgressAnswer;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ShutdownStage {
    /// Not shutting down.
    Running,
    /// No new job is claimed.
    StopClaiming,
    /// Computations are asked to stop.
    StopComputing,
    /// The pool no longer waits for computations that did not stop.
    Abandon,
}

/// Why a computation was asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopReason {
    /// Cancellation of the job was requested.
    Cancelled,
    ShuttingDown,
    LeaseLost,
    /// The attempt exceeded its longest duration.
    TooLong,
}

/// Shared state of a computing thread and its heartbeat. The thread writes its progress, the heartbeat writes the reason to stop.
#[derive(Debug, Default)]
pub(super) struct Control {
    progress: Mutex<Option<ProgressAnswer>>,
    stop: OnceLock<StopReason>,
    stop_requested: Notify,
}

impl Control {
    /// Stores the progress; `Break` if the computation should stop. It is called in every iteration, so it must be cheap.
    pub(super) fn report(&self, progress: ProgressAnswer) -> ControlFlow<()> {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = Some(progress);
        if self.stop.get().is_some() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }

    /// Asks the computation to stop. The first reason counts.
    pub(super) fn stop(&self, reason: StopReason) {
        let _ = self.stop.set(reason);
        self.stop_requested.notify_one();
    }

    /// Resolves when the attempt was asked to stop. Only one task may wait, because `notify_one` wakes only one.
    pub(super) async fn stopped(&self) -> StopReason {
        loop {
            if let Some(reason) = self.stop_reason() {
                return reason;
            }
            self.stop_requested.notified().await;
        }
    }

    /// Resolves when the job was cancelled; never if the attempt was asked to stop for another reason.
    pub(super) async fn cancelled(&self) {
        if self.stopped().await != StopReason::Cancelled {
            std::future::pending().await
        }
    }

    pub(super) fn stop_reason(&self) -> Option<StopReason> {
        self.stop.get().copied()
    }

    fn progress(&self) -> Option<ProgressAnswer> {
        *self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Interval of progress updates; people do not notice a shorter one.
const PROGRESS_EVERY: Duration = Duration::from_millis(300);
/// Longest interval between two reads of the cancel flag, for cancellations that another process accepted.
const RENEW_EVERY: Duration = Duration::from_millis(500);

/// A lease that is being renewed. Dropping it ends the renewal and asks the computation to stop.
pub(super) struct RenewedLease {
    control: Arc<Control>,
    task: JoinHandle<()>,
}

impl RenewedLease {
    pub(super) fn new(renewal: LeaseRenewal) -> RenewedLease {
        RenewedLease {
            control: Arc::clone(&renewal.control),
            task: tokio::spawn(renewal.run()),
        }
    }

    /// The state that is shared with the computation.
    pub(super) fn control(&self) -> &Arc<Control> {
        &self.control
    }

    /// True when the lease is lost, or could not be renewed in time.
    pub(super) fn is_lost(&self) -> bool {
        self.task.is_finished()
    }

    /// Ends the renewal: the job is over.
    pub(super) fn stop(&self) {
        self.task.abort();
    }
}

impl Drop for RenewedLease {
    fn drop(&mut self) {
        self.control.stop(StopReason::LeaseLost);
        self.task.abort();
    }
}

/// The heartbeat of one attempt.
pub(super) struct LeaseRenewal {
    pub(super) store: Store,
    pub(super) lease: Lease,
    pub(super) duration: Duration,
    pub(super) control: Arc<Control>,
    pub(super) signals: JobSignals,
    pub(super) cancellations: Cancellations,
    pub(super) shutdown_stage: watch::Receiver<ShutdownStage>,
}

impl LeaseRenewal {
    /// Renews the lease until it is lost. If the database does not answer, retries until the lease has expired.
    async fn run(mut self) {
        let tick = PROGRESS_EVERY.min(self.duration / 4);
        let renew_every = RENEW_EVERY.min(self.duration / 3);
        let mut renewed = Instant::now();
        let mut written = None;
        loop {
            let renew_now = self.wait(tick).await;
            let progress = self
                .control
                .progress()
                .filter(|progress| written != Some(*progress));
            if !renew_now && progress.is_none() && renewed.elapsed() < renew_every {
                continue;
            }
            let begun = Instant::now();
            // After a pause of the whole process the renewal is still tried once. It fails if another worker has the job.
            let until = (renewed + self.duration).max(begun + self.duration / 4);
            match timeout_at(until, self.renew(progress)).await {
                Ok(Ok(())) => (renewed, written) = (begun, progress.or(written)),
                Ok(Err(Error::Conflict(Conflict::LeaseLost))) | Err(_) => break,
                Ok(Err(error)) if renewed.elapsed() < self.duration => {
                    tracing::warn!(job_id = self.lease.job_id, error = %error.cause(), "the lease could not be renewed; trying again");
                }
                Ok(Err(_)) => break,
            }
        }
        tracing::warn!(
            job_id = self.lease.job_id,
            owner = self.lease.owner,
            attempt = self.lease.attempt,
            "lease lost"
        );
        self.control.stop(StopReason::LeaseLost);
    }

    /// Waits for the next tick; true if the lease should be renewed at once.
    async fn wait(&mut self, tick: Duration) -> bool {
        let stopping = self.control.stop_reason().is_some();
        tokio::select! {
            () = sleep(tick) => false,
            () = self.cancellations.next() => true,
            () = shutdown_reached(&mut self.shutdown_stage, ShutdownStage::StopComputing), if !stopping => {
                self.control.stop(StopReason::ShuttingDown);
                false
            }
        }
    }

    async fn renew(&self, progress: Option<ProgressAnswer>) -> Result<(), Error> {
        let progress_json = progress.map(|progress| serde_json::json!(progress).to_string());
        let renewal = leases::heartbeat(
            &self.store,
            &self.lease,
            self.duration,
            progress_json.as_deref(),
        )
        .await?;
        if renewal.cancel_requested {
            self.control.stop(StopReason::Cancelled);
        }
        if progress.is_some() {
            self.signals.job_changed(&self.lease.job_id);
        }
        Ok(())
    }
}

/// Resolves when the shutdown has reached this stage.
pub(super) async fn shutdown_reached(
    shutdown_stage: &mut watch::Receiver<ShutdownStage>,
    stage: ShutdownStage,
) {
    if shutdown_stage.wait_for(|now| *now >= stage).await.is_err() {
        std::future::pending().await
    }
}
