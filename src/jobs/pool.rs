//! The workers of a process.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, timeout, timeout_at};

use super::heartbeat::{ShutdownStage, shutdown_reached};
use super::run_alone::RunAlone;
use super::worker::COMPUTATION_STOP_TIMEOUT;
use super::{Compute, JobSignals, WorkerContext, queue, run_next_job};
use crate::store::{Store, jobs};

/// Workers that run until they are shut down. If the pool is dropped, they stop at once, and their jobs are computed again when the leases have
/// expired.
#[derive(Debug)]
pub struct WorkerPool {
    shutdown_stage: Arc<watch::Sender<ShutdownStage>>,
    tasks: JoinSet<()>,
}

/// Interval at which an idle worker polls for jobs that another process posted.
const POLL_INTERVAL: Duration = Duration::from_secs(1);
/// Longest interval between two searches for expired leases; it is shorter if leases are shorter.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// Interval at which Idempotency-Keys that are older than a week are deleted.
const KEY_CLEANUP_INTERVAL: Duration = Duration::from_secs(3600);

/// Limits on a job's attempts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttemptLimits {
    /// Duration of a lease.
    pub lease: Duration,
    /// Attempts before a job fails with `attempts_exhausted`.
    pub max_attempts: u32,
    /// Longest duration of one attempt.
    pub max_duration: Duration,
}

impl WorkerPool {
    /// Starts `n_workers` workers, and the sweep that expires leases and deletes old Idempotency-Keys.
    pub fn start(
        store: Store,
        compute: Compute,
        n_workers: usize,
        rules: AttemptLimits,
        signals: JobSignals,
    ) -> WorkerPool {
        let AttemptLimits {
            lease,
            max_attempts,
            max_duration,
        } = rules;
        let shutdown_stage = Arc::new(watch::Sender::new(ShutdownStage::Running));
        let run_alone = Arc::new(RunAlone::new(lease));
        let mut tasks = JoinSet::new();
        for _ in 0..n_workers {
            let context = WorkerContext {
                shutdown_stage: Arc::clone(&shutdown_stage),
                run_alone: Arc::clone(&run_alone),
                max_duration,
                ..WorkerContext::new(compute, lease, signals.clone())
            };
            tasks.spawn(run_worker(store.clone(), context));
        }
        let every = SWEEP_INTERVAL.min(lease / 2).max(Duration::from_millis(1));
        tasks.spawn(run_sweep(
            store,
            max_attempts,
            signals,
            every,
            (n_workers > 0).then_some(run_alone),
            shutdown_stage.subscribe(),
        ));
        WorkerPool {
            shutdown_stage,
            tasks,
        }
    }

    /// Claims no more jobs and lets computations finish. Those that still run shortly before the deadline are stopped, and their jobs go back to
    /// the queue without counting the attempt. Returns at about the deadline at the latest.
    pub async fn shutdown(mut self, deadline: Duration) {
        let deadline = Instant::now() + deadline;
        let stages = [
            (
                ShutdownStage::StopClaiming,
                deadline
                    .checked_sub(2 * COMPUTATION_STOP_TIMEOUT)
                    .unwrap_or(deadline),
            ),
            (
                ShutdownStage::StopComputing,
                deadline
                    .checked_sub(COMPUTATION_STOP_TIMEOUT)
                    .unwrap_or(deadline)
                    .max(Instant::now() + COMPUTATION_STOP_TIMEOUT / 2),
            ),
            (
                ShutdownStage::Abandon,
                deadline.max(Instant::now() + COMPUTATION_STOP_TIMEOUT),
            ),
        ];
        for (stage, until) in stages {
            self.shutdown_stage.send_replace(stage);
            if timeout_at(until, self.wait_for_tasks()).await.is_ok() {
                return;
            }
        }
        tracing::warn!(
            "workers did not end in time; their jobs start again when their leases have expired"
        );
    }

    async fn wait_for_tasks(&mut self) {
        while self.tasks.join_next().await.is_some() {}
    }
}

async fn run_worker(store: Store, context: WorkerContext) {
    let mut shutdown_stage = context.shutdown_stage.subscribe();
    while *shutdown_stage.borrow() == ShutdownStage::Running {
        match run_next_job(&store, &context).await {
            // Continues at once if another job is queued. A read checks this first, because a claim takes SQLite's only writer.
            Ok(Some(_)) if jobs::any_queued(&store).await.unwrap_or(true) => {}
            Ok(_) => {
                tokio::select! {
                    () = context.signals.enqueued() => {}
                    () = sleep(POLL_INTERVAL) => {}
                    () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming) => {}
                }
            }
            Err(error) => {
                tracing::warn!(error = %error.cause(), "no job could be claimed; trying again");
                let _ = timeout(
                    POLL_INTERVAL,
                    shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming),
                )
                .await;
            }
        }
    }
}

async fn run_sweep(
    store: Store,
    max_attempts: u32,
    signals: JobSignals,
    every: Duration,
    run_alone: Option<Arc<RunAlone>>,
    mut shutdown_stage: watch::Receiver<ShutdownStage>,
) {
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut cleaned_up: Option<Instant> = None;
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = shutdown_reached(&mut shutdown_stage, ShutdownStage::StopClaiming) => return,
        }
        if let Err(error) = queue::expire(&store, max_attempts, &signals).await {
            tracing::warn!(error = %error.cause(), "expired leases could not be searched for; trying again");
        }
        if let Some(run_alone) = &run_alone {
            // On an error the next tick tries again.
            if let Ok(any) = jobs::any_suspect_queued(&store).await {
                run_alone.set_suspects_queued(any);
            }
        }
        if cleaned_up.is_none_or(|at| at.elapsed() >= KEY_CLEANUP_INTERVAL) {
            match store.delete_expired_keys().await {
                Ok(()) => cleaned_up = Some(Instant::now()),
                Err(error) => {
                    tracing::warn!(error = %error.cause(), "old Idempotency-Keys could not be deleted; trying again")
                }
            }
        }
    }
}
