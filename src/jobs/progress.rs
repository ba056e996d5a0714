//! Signals of new jobs and cancellations to workers, and of changes to long polls and event streams. Signals only shorten waiting: the state is
//! always read from the database, and listeners also poll, because a signal may be lost.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, broadcast};
use tokio::time::{Instant, timeout_at};

use crate::store::{Engine, JobRow, JobStatus, Result, Store, jobs};

/// Signals within this process; clones share them. [`super::relay`] sends them to other processes.
#[derive(Clone, Debug)]
pub struct JobSignals {
    enqueued: Arc<Notify>,
    /// Signals of this and other processes.
    received: broadcast::Sender<Signal>,
    /// Signals of this process, for the relay.
    sent: broadcast::Sender<Signal>,
}

/// A change for which a worker or a listener may wait.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Signal {
    Enqueued,
    Changed(Arc<str>),
    CancelRequested(Arc<str>),
    /// Something may have changed: read the database.
    Unknown,
}

/// The text sent to other processes.
impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Signal::Enqueued => f.write_str("enqueued"),
            Signal::Changed(id) => write!(f, "changed {id}"),
            Signal::CancelRequested(id) => write!(f, "cancel {id}"),
            Signal::Unknown => f.write_str("anything"),
        }
    }
}

/// A text of another process. An unknown text, from a newer version, is [`Signal::Unknown`].
impl From<&str> for Signal {
    fn from(text: &str) -> Self {
        match text.split_once(' ') {
            None if text == "enqueued" => Signal::Enqueued,
            Some(("changed", id)) => Signal::Changed(id.into()),
            Some(("cancel", id)) => Signal::CancelRequested(id.into()),
            _ => Signal::Unknown,
        }
    }
}

/// Number of signals that are buffered for a slow listener. A listener that falls further behind reads the database.
const SIGNAL_BUFFER: usize = 256;
/// Poll interval of listeners on PostgreSQL: another process may run the job, and its notice may be lost.
const POLL_POSTGRES: Duration = Duration::from_millis(500);
/// Poll interval of listeners on SQLite: every job runs in this process.
const POLL_SQLITE: Duration = Duration::from_secs(2);

impl Default for JobSignals {
    fn default() -> Self {
        JobSignals {
            enqueued: Arc::default(),
            received: broadcast::Sender::new(SIGNAL_BUFFER),
            sent: broadcast::Sender::new(SIGNAL_BUFFER),
        }
    }
}

impl JobSignals {
    /// A job was posted and its transaction committed: wakes a worker.
    pub fn job_enqueued(&self) {
        self.raise(Signal::Enqueued);
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
        let _ = self.sent.send(signal.clone());
        self.deliver(signal);
    }

    /// Handles a signal of this or another process.
    pub(super) fn deliver(&self, signal: Signal) {
        match signal {
            Signal::Enqueued => self.enqueued.notify_one(),
            Signal::Unknown => {
                // Wakes all workers that wait now, and the next one that will wait.
                self.enqueued.notify_waiters();
                self.enqueued.notify_one();
                let _ = self.received.send(signal);
            }
            Signal::Changed(_) | Signal::CancelRequested(_) => {
                let _ = self.received.send(signal);
            }
        }
    }

    /// Subscribes to the signals of this process.
    pub(super) fn sent(&self) -> broadcast::Receiver<Signal> {
        self.sent.subscribe()
    }

    /// Waits until the job's status is not `seen` or the job has ended, at most for `timeout`: a long poll.
    pub async fn wait_for_status_change(
        &self,
        store: &Store,
        job_id: &str,
        seen: JobStatus,
        timeout: Duration,
    ) -> Result<JobRow> {
        self.wait(store, job_id, timeout, |job| job.status != seen)
            .await
    }

    /// Waits until status, attempt or progress of the job differ from `seen` or the job has ended, at most for `timeout`: one step of an event
    /// stream.
    pub async fn wait_for_change(
        &self,
        store: &Store,
        seen: &JobRow,
        timeout: Duration,
    ) -> Result<JobRow> {
        self.wait(store, &seen.id, timeout, |job| job.has_moved_on(seen))
            .await
    }

    async fn wait(
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
        let mut signals = self.received.subscribe();
        let is_meant = |signal: &Signal| match signal {
            Signal::Changed(id) | Signal::CancelRequested(id) => **id == *job_id,
            Signal::Enqueued | Signal::Unknown => false,
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
            signals: self.received.subscribe(),
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

/// Resolves at such a signal, or if one may have been missed.
async fn next_signal(
    signals: &mut broadcast::Receiver<Signal>,
    is_meant: impl Fn(&Signal) -> bool,
) {
    loop {
        match signals.recv().await {
            Ok(signal) if matches!(signal, Signal::Unknown) || is_meant(&signal) => return,
            Ok(_) => {}
            Err(broadcast::error::RecvError::Lagged(_)) => return,
            Err(broadcast::error::RecvError::Closed) => std::future::pending().await,
        }
    }
}
