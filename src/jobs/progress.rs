//! Signals of new jobs and cancellations to workers, and of changes to long polls and event streams. Signals only shorten waiting: the state is
//! always read from the database, and listeners also poll, because another process may change a job.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, broadcast};
use tokio::time::{Instant, timeout_at};

use crate::store::{Engine, JobRow, Result, Store, jobs};

/// Signals within this process; clones share them. Other processes on the same database poll.
#[derive(Clone, Debug)]
pub struct JobSignals {
    enqueued: Arc<Notify>,
    changes: broadcast::Sender<Signal>,
}

/// A change of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Signal {
    Changed(Arc<str>),
    CancelRequested(Arc<str>),
}

/// Number of signals that are buffered for a slow listener. A listener that falls further behind reads the database.
const SIGNAL_BUFFER: usize = 256;
/// Poll interval of listeners on PostgreSQL: another process may run the job.
const POLL_POSTGRES: Duration = Duration::from_millis(500);
/// Poll interval of listeners on SQLite: every job runs in this process.
const POLL_SQLITE: Duration = Duration::from_secs(2);

impl Default for JobSignals {
    fn default() -> Self {
        JobSignals {
            enqueued: Arc::default(),
            changes: broadcast::Sender::new(SIGNAL_BUFFER),
        }
    }
}

impl JobSignals {
    /// A job was posted and its transaction committed: wakes a worker.
    pub fn job_enqueued(&self) {
        self.enqueued.notify_one();
    }

    /// A job's status or progress changed: wakes its listeners.
    pub fn job_changed(&self, job_id: &str) {
        self.raise(Signal::Changed(job_id.into()));
    }

    /// Cancellation of a job was requested: wakes its worker and its listeners.
    pub fn job_cancel_requested(&self, job_id: &str) {
        self.raise(Signal::CancelRequested(job_id.into()));
    }

    fn raise(&self, signal: Signal) {
        // An error only means that there is no listener.
        let _ = self.changes.send(signal);
    }

    /// Waits until the job has changed in this way or has ended, at most for `timeout`: a long poll, or one step of an event stream.
    pub async fn wait_for_change(
        &self,
        store: &Store,
        job_id: &str,
        timeout: Duration,
        has_changed: impl Fn(&JobRow) -> bool,
    ) -> Result<JobRow> {
        let poll = match store.engine() {
            Engine::Sqlite => POLL_SQLITE,
            Engine::Postgres => POLL_POSTGRES,
        };
        let deadline = Instant::now() + timeout;
        // Subscribes before the first read, so that no change is missed.
        let mut signals = self.changes.subscribe();
        let is_meant = |signal: &Signal| {
            let (Signal::Changed(id) | Signal::CancelRequested(id)) = signal;
            **id == *job_id
        };
        loop {
            let job = jobs::get(store, job_id).await?;
            if job.status.is_over() || has_changed(&job) || Instant::now() >= deadline {
                return Ok(job);
            }
            let next_poll = deadline.min(Instant::now() + poll);
            let _ = timeout_at(next_poll, next_signal(&mut signals, is_meant)).await;
        }
    }

    /// Resolves when a job was enqueued since the last call.
    pub(super) async fn enqueued(&self) {
        self.enqueued.notified().await;
    }

    pub(super) fn cancellations(&self, job_id: &str) -> Cancellations {
        Cancellations {
            job_id: job_id.to_owned(),
            signals: self.changes.subscribe(),
        }
    }
}

/// Listens for cancellation requests of one job.
pub(super) struct Cancellations {
    job_id: String,
    signals: broadcast::Receiver<Signal>,
}

impl Cancellations {
    pub(super) async fn next(&mut self) {
        let is_meant =
            |signal: &Signal| matches!(signal, Signal::CancelRequested(id) if **id == *self.job_id);
        next_signal(&mut self.signals, is_meant).await;
    }
}

/// Resolves at the next signal for which `is_meant` is true, or if signals were lost.
async fn next_signal(
    signals: &mut broadcast::Receiver<Signal>,
    is_meant: impl Fn(&Signal) -> bool,
) {
    loop {
        match signals.recv().await {
            Ok(signal) if is_meant(&signal) => return,
            Ok(_) => {}
            Err(broadcast::error::RecvError::Lagged(_)) => return,
            Err(broadcast::error::RecvError::Closed) => std::future::pending().await,
        }
    }
}
