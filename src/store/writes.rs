//! Whether the writes of this process succeed. Used on SQLite.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// What this process knows of its own writes. Used on SQLite, where the commands of `kincal` are the only other writers.
#[derive(Debug, Default)]
pub(super) struct Writes(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// Whether a write was requested after the last commit. Without a commit it does not show that writes succeed: its request may have been
    /// refused, or it had nothing to write.
    is_unproven: bool,
    last_commit: Option<Instant>,
    /// Start of the first write whose failure became known after the last commit.
    failing_since: Option<Instant>,
    /// Start of the trial write that runs now.
    trial_since: Option<Instant>,
}

impl Writes {
    pub(super) fn requested(&self) {
        self.state().is_unproven = true;
    }

    pub(super) fn committed(&self) {
        let mut state = self.state();
        state.is_unproven = false;
        state.failing_since = None;
        state.last_commit = Some(Instant::now());
    }

    /// Records a write that did not get its transaction, or whose commit failed.
    pub(super) fn failed(&self, begun: Instant) {
        self.state().failing_since.get_or_insert(begun);
    }

    /// Whether a trial is needed and none runs. The caller starts it.
    pub(super) fn take_trial(&self) -> bool {
        let mut state = self.state();
        let is_needed = state.is_unproven || state.failing_since.is_some();
        let is_mine = is_needed && state.trial_since.is_none();
        if is_mine {
            state.trial_since = Some(Instant::now());
        }
        is_mine
    }

    pub(super) fn trial_ended(&self) {
        self.state().trial_since = None;
    }

    /// Time for which no write has succeeded, while writes fail or a trial runs.
    pub(super) fn stuck_for(&self) -> Option<Duration> {
        let state = self.state();
        let starts = [state.failing_since, state.trial_since];
        let first = starts.into_iter().flatten().min()?;
        // Other writes may have been committed while this one waited.
        Some(Some(first).max(state.last_commit)?.elapsed())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::Writes;
    use tokio::time::Instant;

    #[test]
    fn only_a_commit_shows_that_writes_succeed() {
        let writes = Writes::default();
        assert!(!writes.take_trial(), "nobody has written");
        writes.requested();
        assert_eq!(
            writes.stuck_for(),
            None,
            "the request may have been refused"
        );
        assert!(writes.take_trial() && !writes.take_trial(), "one at a time");
        assert!(writes.stuck_for().is_some(), "the trial runs");
        writes.failed(Instant::now());
        writes.trial_ended();
        // A transaction that had nothing to write, or was refused.
        writes.requested();
        assert!(writes.stuck_for().is_some() && writes.take_trial());
        writes.trial_ended();
        writes.committed();
        assert!(writes.stuck_for().is_none() && !writes.take_trial());
    }
}
