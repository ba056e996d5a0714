//! Runs suspect jobs alone. A suspect is a job that was running when its process died. If the process dies again while a suspect runs alone, that job
//! is the cause.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock};
use tokio::time::{Instant, timeout};

/// Time that a suspect waits while other jobs run, in leases. After that this process starts no new job, lets the running ones end, and runs the
/// suspect.
const LEASES_TO_WAIT: u32 = 2;
/// Longest wait for workers that are claiming a job at this moment.
const CLAIM_TIMEOUT: Duration = Duration::from_millis(100);

/// Decides which jobs may run at the same time in this process.
#[derive(Debug)]
pub(super) struct RunAlone {
    jobs: Arc<RwLock<()>>,
    suspect_wait: Duration,
    suspects_since: Mutex<Option<Instant>>,
}

/// Permit to run a job in this process.
#[derive(Debug)]
pub(super) enum Permit {
    /// The job runs together with other jobs.
    Shared(#[allow(dead_code, reason = "held")] OwnedRwLockReadGuard<()>),
    /// The job runs alone.
    Alone(#[allow(dead_code, reason = "held")] OwnedRwLockWriteGuard<()>),
}

impl RunAlone {
    pub(super) fn new(lease: Duration) -> Self {
        RunAlone {
            jobs: Arc::default(),
            suspect_wait: lease * LEASES_TO_WAIT,
            suspects_since: Mutex::default(),
        }
    }

    /// Waits for a permit to run together with other jobs. No such permit is given while a suspect runs or is due.
    pub(super) async fn shared(&self) -> Permit {
        Permit::Shared(Arc::clone(&self.jobs).read_owned().await)
    }

    /// Waits for a permit to run alone: until the running jobs have ended. No other job starts meanwhile.
    pub(super) async fn alone(&self) -> Permit {
        Permit::Alone(Arc::clone(&self.jobs).write_owned().await)
    }

    /// A permit to run alone if no job runs now.
    pub(super) async fn try_alone(&self) -> Option<Permit> {
        timeout(CLAIM_TIMEOUT, self.alone()).await.ok()
    }

    /// Records whether suspects are queued.
    pub(super) fn set_suspects_queued(&self, any: bool) {
        let mut since = self.suspects_since();
        *since = any.then(|| since.unwrap_or_else(Instant::now));
    }

    /// Whether a suspect has waited long enough.
    pub(super) fn suspect_is_due(&self) -> bool {
        self.suspects_since()
            .is_some_and(|since| since.elapsed() >= self.suspect_wait)
    }

    pub(super) fn suspect_started(&self) {
        *self.suspects_since() = None;
    }

    fn suspects_since(&self) -> std::sync::MutexGuard<'_, Option<Instant>> {
        self.suspects_since
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
