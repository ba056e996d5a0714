//! Finds out for how long writers have been blocked.

use std::time::Duration;

use tokio::time::{Instant, timeout};

use super::sql::{self, values};
use super::{Engine, Result, Store};

pub(super) const QUERIES_POSTGRES: &[&str] = &[LOCK_HOLDER];

pub(super) const QUERIES_SQLITE: &[&str] = &[TRIAL_WRITE];

// The session that has blocked writers for the longest time. It does not wait for a lock itself; other sessions wait for it, or it holds
// the head of the audit chain, which every write needs. `state_change` is the time at which the session last began or finished a statement.
const LOCK_HOLDER: &str = "
    select cast(extract(epoch from clock_timestamp() - holder.state_change) * 1000 as bigint) as held_ms,
        case when holder.state like 'idle in transaction%' then 1 else 0 end as is_idle
    from pg_stat_activity holder
    where holder.datname = current_database() and holder.pid <> pg_backend_pid() and holder.state_change is not null
        and holder.wait_event_type is distinct from 'Lock'
        and holder.pid in (
            select held.pid from pg_locks held
            where held.relation = cast('audit_head' as regclass) and held.granted
                and held.mode not in ('AccessShareLock', 'ShareUpdateExclusiveLock')
            union all
            select unnest(pg_blocking_pids(waiting.pid)) from pg_stat_activity waiting
            where waiting.datname = current_database() and waiting.wait_event_type = 'Lock')
    order by holder.state_change limit 1";

// Writes the header of the database's file with the same value. Unlike an update that changes nothing, this reaches the disk.
const TRIAL_WRITE: &str = "pragma user_version = 0";

/// Longest wait for the trial. Where the lock is free and the disk works, it needs less time.
const TRIAL_TIMEOUT: Duration = Duration::from_millis(200);

/// Blocked writers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StuckWriters {
    /// Time for which no write has succeeded.
    pub duration: Duration,
    /// What the writers wait for, without internal details.
    pub reason: &'static str,
}

impl std::fmt::Display for StuckWriters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let StuckWriters { duration, reason } = self;
        let seconds = duration.as_secs_f64();
        write!(f, "no write has succeeded for {seconds:.1} s: {reason}")
    }
}

/// The blocked writers; none if no write is blocked.
pub async fn stuck_writers(store: &Store) -> Result<Option<StuckWriters>> {
    if store.engine() == Engine::Sqlite {
        return Ok(stuck_sqlite_writers(store).await);
    }
    let holder: Option<(i64, i32)> = sql::first(store.readers(), LOCK_HOLDER, values![]).await?;
    Ok(holder.map(|(held_ms, is_idle)| StuckWriters {
        duration: Duration::from_millis(u64::try_from(held_ms).unwrap_or(0)),
        reason: match is_idle {
            0 => "another connection's statement holds a lock that they need",
            _ => "another connection holds a lock that they need and is idle in its transaction",
        },
    }))
}

/// If nothing was committed after the last write that was requested, a trial write shows whether writes succeed. The caller waits at most
/// [`TRIAL_TIMEOUT`] for it; a trial that takes longer goes on, and no second one begins beside it.
async fn stuck_sqlite_writers(store: &Store) -> Option<StuckWriters> {
    let writes = &store.inner.writes;
    if writes.take_trial() {
        let trial = RunningTrial(store.clone());
        let trial = tokio::spawn(async move {
            let begun = Instant::now();
            if write_trial(&trial.0).await.is_err() {
                trial.0.inner.writes.failed(begun);
            }
        });
        let _ = timeout(TRIAL_TIMEOUT, trial).await;
    }
    writes.stuck_for().map(|duration| StuckWriters {
        duration,
        reason: "another program locks the database, or its disk has an error",
    })
}

/// A trial write. Dropping it ends the trial, also if it panics.
struct RunningTrial(Store);

impl Drop for RunningTrial {
    fn drop(&mut self) {
        self.0.inner.writes.trial_ended();
    }
}

async fn write_trial(store: &Store) -> Result<()> {
    let mut tx = store.begin().await?;
    sql::execute(tx.connection(), TRIAL_WRITE, values![]).await?;
    tx.commit().await
}

#[cfg(test)]
mod tests {
    use super::stuck_writers;
    use crate::store::{Store, StoreLocation};
    use sqlx::Executor;

    #[tokio::test]
    async fn writers_are_stuck_until_a_trial_is_committed() {
        let dir = tempfile::tempdir().unwrap();
        let data_dir = dir.path().to_owned();
        let store = Store::open(StoreLocation::Sqlite { data_dir })
            .await
            .unwrap();
        let writers = store.writers();
        writers.execute("pragma query_only = on").await.unwrap();
        assert!(store.begin().await.is_err());
        let first = stuck_writers(&store).await.unwrap().unwrap();
        let second = stuck_writers(&store).await.unwrap().unwrap();
        assert!(second.duration > first.duration);
        writers.execute("pragma query_only = off").await.unwrap();
        // On a busy machine a trial takes longer than its caller waits.
        while stuck_writers(&store).await.unwrap().is_some() {
            tokio::task::yield_now().await;
        }
        store.close().await;
    }
}
