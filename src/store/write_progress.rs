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
    /// Whether the last finished write failed.
    has_failed: bool,
    /// Start of the period without a successful write; none if no write is waiting and the last write did not fail.
    since: Option<Instant>,
}

/// One write, from the request for a transaction to its end.
#[derive(Debug)]
pub(super) struct PendingWrite {
    progress: Arc<WriteProgress>,
    /// Result of the last step; none if the client disconnected while the write waited.
    succeeded: Option<bool>,
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
            succeeded: None,
        }
    }

    /// Records the result of a step: the start of the transaction, or its commit.
    pub(super) fn record<T>(&mut self, result: &Result<T>) {
        self.succeeded = Some(result.is_ok());
    }
}

impl Drop for PendingWrite {
    fn drop(&mut self) {
        let mut state = self.progress.state();
        state.n_under_way -= 1;
        state.has_failed = self.succeeded.map_or(state.has_failed, |success| !success);
        if self.succeeded == Some(true) {
            state.since = (state.n_under_way > 0).then(Instant::now);
        } else if state.n_under_way == 0 && !state.has_failed {
            state.since = None;
        }
    }
}
