//! Runs suspect jobs alone. A suspect is a job that was running when its process died. If the process dies again while a suspect runs alone, that job
//! is the cause.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedRwLockReadGuard, OwnedRwLockWriteGuard, RwLock, watch};
use tokio::task::JoinHandle;
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
    /// Number of computations that were given up and still run.
    n_given_up: Arc<watch::Sender<usize>>,
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
            n_given_up: Arc::default(),
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

    /// Counts a computation that was given up and still runs, until it ends. It keeps its permit: what runs beside it does not run alone. So no
    /// suspect runs in this process meanwhile, and none keeps other jobs waiting.
    pub(super) fn given_up<T: Send + 'static>(&self, thread: JoinHandle<T>) {
        let n_given_up = Arc::clone(&self.n_given_up);
        n_given_up.send_modify(|n| *n += 1);
        tokio::spawn(async move {
            let _ = thread.await;
            n_given_up.send_modify(|n| *n -= 1);
        });
    }

    /// Waits until a computation that was given up still runs.
    pub(super) async fn any_given_up(&self) {
        let mut n_given_up = self.n_given_up.subscribe();
        // The sender lives as long as this.
        let _ = n_given_up.wait_for(|n| *n > 0).await;
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

    /// Whether a suspect has waited long enough and can run.
    pub(super) fn suspect_is_due(&self) -> bool {
        *self.n_given_up.borrow() == 0
            && self
                .suspects_since()
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

#[cfg(test)]
mod tests {
    use super::RunAlone;
    use std::time::Duration;

    #[tokio::test]
    async fn a_suspect_is_not_due_while_a_computation_that_was_given_up_runs() {
        let run_alone = RunAlone::new(Duration::ZERO);
        run_alone.set_suspects_queued(true);
        assert!(run_alone.suspect_is_due());
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        run_alone.given_up(tokio::spawn(ended));
        run_alone.any_given_up().await;
        assert!(!run_alone.suspect_is_due());
        end.send(()).unwrap();
        let mut n_given_up = run_alone.n_given_up.subscribe();
        n_given_up.wait_for(|n| *n == 0).await.unwrap();
        assert!(run_alone.suspect_is_due());
    }
}
