//! Measures for how long no write has succeeded. Used on SQLite.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use super::Result;

/// Progress of the writes of this process.
#[derive(Debug, Default)]
pub(super) struct WriteProgress(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    n_under_way: usize,
    /// Whether the last finished write failed, or left open whether writes succeed.
    is_in_doubt: bool,
    /// Start of the period without a successful write; none if no write is waiting and none is in doubt.
    since: Option<Instant>,
}

/// One write, from the request for a transaction to its end.
#[derive(Debug)]
pub(super) struct PendingWrite {
    progress: Arc<WriteProgress>,
    reached: Reached,
}

/// How far a write came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reached {
    /// It waits for its transaction. If it ends here, its client went away, which says nothing.
    Waiting,
    /// Its transaction began, so no lock blocks writers. If it ends here, its request was refused or one of its statements failed, which is not
    /// told apart: whether writes succeed is open.
    Begun,
    /// It was committed, or had nothing to write.
    Succeeded,
    /// Its transaction did not begin, or its commit failed.
    Failed,
}

impl WriteProgress {
    pub(super) fn stuck_for(&self) -> Option<Duration> {
        self.state().since.map(|since| since.elapsed())
    }

    pub(super) fn is_any_under_way(&self) -> bool {
        self.state().n_under_way > 0
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PendingWrite {
    pub(super) fn begin(progress: &Arc<WriteProgress>) -> Self {
        let mut state = progress.state();
        state.n_under_way += 1;
        state.since.get_or_insert_with(Instant::now);
        drop(state);
        PendingWrite {
            progress: Arc::clone(progress),
            reached: Reached::Waiting,
        }
    }

    /// Records whether the transaction began.
    pub(super) fn begun<T>(&mut self, result: &Result<T>) {
        self.reached = match result {
            Ok(_) => Reached::Begun,
            Err(_) => Reached::Failed,
        };
    }

    /// Records whether the transaction was committed, or rolled back because it had nothing to write.
    pub(super) fn ended<T>(&mut self, result: &Result<T>) {
        self.reached = match result {
            Ok(_) => Reached::Succeeded,
            Err(_) => Reached::Failed,
        };
    }
}

impl Drop for PendingWrite {
    fn drop(&mut self) {
        let mut state = self.progress.state();
        state.n_under_way -= 1;
        match self.reached {
            Reached::Succeeded => {
                state.is_in_doubt = false;
                state.since = (state.n_under_way > 0).then(Instant::now);
            }
            Reached::Failed => state.is_in_doubt = true,
            Reached::Begun if !state.is_in_doubt => {
                state.is_in_doubt = true;
                state.since = Some(Instant::now());
            }
            Reached::Waiting if state.n_under_way == 0 && !state.is_in_doubt => state.since = None,
            Reached::Begun | Reached::Waiting => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{PendingWrite, WriteProgress};
    use crate::store::{Error, Result};
    use std::sync::Arc;

    fn begun(progress: &Arc<WriteProgress>) -> PendingWrite {
        let mut write = PendingWrite::begin(progress);
        write.begun(&Result::Ok(()));
        write
    }

    fn failed() -> Result<()> {
        Err(Error::Database(sqlx::Error::WorkerCrashed))
    }

    #[test]
    fn a_transaction_that_began_and_was_not_committed_is_no_success() {
        let progress = Arc::default();
        drop(begun(&progress));
        assert!(progress.stuck_for().is_some(), "a trial has to show it");
        // Nor does it make good for a failure before it.
        begun(&progress).ended(&failed());
        let since = progress.state().since;
        drop(begun(&progress));
        assert_eq!(progress.state().since, since);
        begun(&progress).ended(&Result::Ok(()));
        assert_eq!(progress.stuck_for(), None);
    }

    #[test]
    fn refused_requests_are_not_told_as_a_period_without_a_write() {
        let progress = Arc::default();
        let _other = PendingWrite::begin(&progress);
        let before = progress.state().since;
        drop(begun(&progress));
        assert!(progress.state().since > before, "no lock blocks writers");
    }

    #[test]
    fn a_client_that_goes_away_while_it_waits_says_nothing() {
        let progress = Arc::default();
        drop(PendingWrite::begin(&progress));
        assert_eq!(progress.stuck_for(), None);
        let mut refused = PendingWrite::begin(&progress);
        refused.begun(&failed());
        drop(refused);
        drop(PendingWrite::begin(&progress));
        assert!(progress.stuck_for().is_some());
    }
}
