//! Whether the writes of this process succeed. Used on SQLite.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// A failed write shows that writes fail for so long. A write waits at most 5 s, so writes that go on failing are closer together.
const FAILURE_IS_RECENT: Duration = Duration::from_secs(10);

/// What this process knows of its own writes. Used on SQLite, where the commands of `kincal` are the only other writers.
#[derive(Debug, Default)]
pub(super) struct Writes(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// Whether a write was requested after the last commit. Without a commit it does not show that writes succeed: its request may have been
    /// refused, or it had nothing to write.
    is_unproven: bool,
    last_commit: Option<Instant>,
    /// Start of the first write, and end of the last one, whose failure became known after the last commit.
    failing: Option<(Instant, Instant)>,
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
        state.failing = None;
        state.last_commit = Some(Instant::now());
    }

    /// Records a write that did not get its transaction, or whose commit failed.
    pub(super) fn failed(&self, begun: Instant) {
        let mut state = self.state();
        let since = state.failing.map_or(begun, |(since, _)| since);
        state.failing = Some((since, Instant::now()));
    }

    /// Whether a trial is needed and none runs. The caller starts it.
    pub(super) fn take_trial(&self) -> bool {
        let mut state = self.state();
        let is_needed = state.is_unproven || state.failing.is_some();
        let is_mine = is_needed && state.trial_since.is_none();
        if is_mine {
            state.trial_since = Some(Instant::now());
        }
        is_mine
    }

    pub(super) fn trial_ended(&self) {
        self.state().trial_since = None;
    }

    /// Time for which no write has succeeded, while writes fail or a trial runs. Failures that were no longer recent when the trial began end where
    /// they ended, so that a slow trial does not make an old failure last until now.
    pub(super) fn stuck_for(&self) -> Option<Duration> {
        let (state, now) = (self.state(), Instant::now());
        let on_trial = state.trial_since.map(|since| (since, now));
        let failing = state.failing.map(|(since, last)| {
            let is_recent = state.trial_since.unwrap_or(now) < last + FAILURE_IS_RECENT;
            (since, if is_recent { now } else { last })
        });
        // Other writes may have been committed while this one waited.
        let without_commit = |(since, until): (Instant, Instant)| {
            until - state.last_commit.map_or(since, |at| at.max(since))
        };
        let times = [failing, on_trial].into_iter().flatten();
        times.map(without_commit).max()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::Writes;
    use std::time::Duration;
    use tokio::time::Instant;

    #[test]
    fn a_slow_trial_joins_a_recent_failure_and_not_an_old_one() {
        let now = Instant::now();
        let ago = |minutes: f64| now - Duration::from_secs_f64(60.0 * minutes);
        let stuck_min = |(since, last), trial| {
            let writes = Writes::default();
            writes.state().failing = Some((ago(since), ago(last)));
            writes.state().trial_since = Some(ago(trial));
            writes.stuck_for().unwrap().as_secs() / 60
        };
        assert_eq!(stuck_min((8.0, 7.1), 7.0), 8, "the trial hangs");
        assert_eq!(stuck_min((90.0, 85.0), 0.1), 5, "the failure is old");
        assert_eq!(stuck_min((90.0, 85.0), 6.0), 6, "the trial takes longer");
    }

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
