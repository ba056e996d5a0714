//! One worker: the outcome of a job for each way in which its computation can end.

use std::time::Duration;

use kincal::jobs::{JobSignals, WorkerContext, queue, run_next_job};
use kincal::store::{
    Engine, Error, JobRow, JobStatus, MeasurementSetRow, NewJob, NewParameterSet, Store, frames,
    jobs, networks, parameter_sets, report_summaries,
};

use crate::computations::{LONG, a_worker, arrived, gate, until};
use crate::engines::{TestDatabase, for_each_engine};
use crate::fixtures::{a_job, a_lone_job, a_robot, a_set, everything, in_transaction, new_job};

async fn some_set(database: &TestDatabase) -> MeasurementSetRow {
    a_set(&database.store, &a_robot(&database.store, "r").await).await
}

/// Starts the only waiting job in the background.
fn begin(store: &Store, context: &WorkerContext) -> tokio::task::JoinHandle<()> {
    let (store, context) = (store.clone(), context.clone());
    tokio::spawn(async move {
        run_next_job(&store, &context)
            .await
            .unwrap()
            .expect("a job waits");
    })
}

/// Runs jobs until the queue is empty.
async fn run_pending_jobs(store: &Store, context: &WorkerContext) -> Result<Vec<String>, Error> {
    let mut done = Vec::new();
    while let Some(job_id) = run_next_job(store, context).await? {
        done.push(job_id);
    }
    Ok(done)
}

fn code(job: &JobRow) -> String {
    let error: serde_json::Value =
        serde_json::from_str(job.error_json.as_ref().expect("an error")).unwrap();
    error["code"].as_str().unwrap().to_owned()
}

#[test]
fn a_job_leaves_its_report_its_curve_its_parameter_set_and_its_network() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "succeed").await;
        assert_eq!(
            run_next_job(store, &a_worker(LONG)).await.unwrap().as_ref(),
            Some(&job.id)
        );
        let done = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (done.status, done.attempt, done.result_sha256.as_deref()),
            (JobStatus::Succeeded, 1, Some("abcd"))
        );
        assert!(done.started_at_ms.unwrap() <= done.finished_at_ms.unwrap());
        assert_eq!(
            jobs::report(store, &job.id).await.unwrap(),
            r#"{"n_bytes":9}"#
        );
        assert_eq!(
            report_summaries::of_job(store, &job.id).await.unwrap(),
            r#"{"n_bytes":9}"#
        );
        assert_eq!(
            jobs::convergence(store, &job.id).await.unwrap(),
            r#"{"iteration":[0],"best_cost_mm2":[1.5]}"#
        );
        let set = parameter_sets::get(store, &done.parameter_set_id.unwrap())
            .await
            .unwrap();
        assert_eq!(
            (set.robot_id, set.job_id, set.body_json.as_str()),
            (job.robot_id, job.id, r#"{"links":[]}"#)
        );
        assert_eq!(
            networks::weights(store, &done.network_id.unwrap())
                .await
                .unwrap(),
            [0, 1, 255]
        );
        assert_eq!(run_next_job(store, &a_worker(LONG)).await.unwrap(), None);
    });
}

/// SQLite has no lock that blocks readers.
#[test]
fn inputs_that_cannot_be_read_for_a_while_use_up_no_attempt() {
    for_each_engine(async |database| {
        let store = &database.store;
        if store.engine() == Engine::Sqlite {
            return;
        }
        let job = a_lone_job(store, "succeed").await;
        let mut lock = store.readers().begin().await.unwrap();
        for statement in [
            "set local idle_in_transaction_session_timeout = 0",
            "lock table robot in access exclusive mode",
        ] {
            sqlx::query(statement).execute(&mut *lock).await.unwrap();
        }
        // Meanwhile expired leases are collected, as a pool does.
        let sweep = tokio::spawn({
            let store = store.clone();
            async move {
                let mut every = tokio::time::interval(Duration::from_millis(100));
                loop {
                    every.tick().await;
                    queue::expire(&store, 3, &JobSignals::default())
                        .await
                        .unwrap();
                }
            }
        });
        // The database gives up waiting for the lock after 2 s, as late as the worker.
        assert_eq!(
            run_next_job(store, &a_worker(Duration::from_secs(2)))
                .await
                .unwrap()
                .as_ref(),
            Some(&job.id)
        );
        sweep.abort();
        let waiting = jobs::get(store, &job.id).await.unwrap();
        assert_eq!((waiting.status, waiting.attempt), (JobStatus::Queued, 0));
        lock.rollback().await.unwrap();
        run_next_job(store, &a_worker(LONG)).await.unwrap();
        let done = jobs::get(store, &job.id).await.unwrap();
        assert_eq!((done.status, done.attempt), (JobStatus::Succeeded, 1));
    });
}

#[test]
fn nothing_is_computed_before_the_claim_is_certain() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    static COMPUTED: AtomicUsize = AtomicUsize::new(0);
    fn count(
        inputs: &kincal::jobs::JobInputs,
        monitor: crate::computations::Monitor<'_>,
    ) -> crate::computations::Computed {
        COMPUTED.fetch_add(1, Ordering::SeqCst);
        crate::computations::run_scripted(inputs, monitor)
    }
    for_each_engine(async |database| {
        let store = &database.store;
        let before = COMPUTED.load(Ordering::SeqCst);
        let job = a_lone_job(store, "succeed").await;
        // The violation is only detected at the commit.
        let sabotage = match store.engine() {
            Engine::Sqlite => vec![
                "create table owed (robot_id text references robot (id) deferrable initially deferred)",
                "create trigger sabotage after update of status on job when new.status = 'running' begin insert into owed values ('none'); end",
            ],
            Engine::Postgres => vec![
                "create table owed (robot_id text references robot (id) deferrable initially deferred)",
                "create function owe() returns trigger language plpgsql as 'begin insert into owed values (''none''); return null; end'",
                "create trigger sabotage after update of status on job for each row when (new.status = 'running') execute function owe()",
            ],
        };
        for statement in sabotage {
            sqlx::query(statement)
                .execute(store.readers())
                .await
                .unwrap();
        }
        let worker = WorkerContext::new(count, LONG, JobSignals::default());
        run_next_job(store, &worker).await.unwrap_err();
        let waiting = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (
                waiting.status,
                waiting.attempt,
                COMPUTED.load(Ordering::SeqCst) - before
            ),
            (JobStatus::Queued, 0, 0)
        );
        let undo = if store.engine() == Engine::Sqlite {
            "drop trigger sabotage"
        } else {
            "drop trigger sabotage on job"
        };
        sqlx::query(undo).execute(store.readers()).await.unwrap();
        assert_eq!(
            run_next_job(store, &worker).await.unwrap().as_ref(),
            Some(&job.id)
        );
        assert_eq!(COMPUTED.load(Ordering::SeqCst) - before, 1);
    });
}

#[test]
fn a_computation_gets_everything_that_its_job_names() {
    use kincal::jobs::{JobFailure, JobInputs, JobOutcome};
    fn tell(
        inputs: &JobInputs,
        _: crate::computations::Monitor<'_>,
    ) -> Result<JobOutcome, JobFailure> {
        let ids = serde_json::json!({
            "robot": inputs.robot.id, "status": inputs.job.status.as_str(), "set": inputs.sets[0].row.id,
            "verify_set": inputs.verify_set.as_ref().map(|set| (&set.row.id, &set.body)),
            "frames": inputs.frames.as_ref().map(|frames| &frames.id),
            "network": inputs.network.as_ref().map(|network| (&network.row.id, &network.weights)),
            "parameter_set": inputs.parameter_set.as_ref().map(|set| &set.row.id),
        });
        let ids = kincal::wire::Problem::new(500, "internal", ids.to_string());
        Err(JobFailure::Failed(Box::new(ids)))
    }
    for_each_engine(async |database| {
        let store = &database.store;
        let set = some_set(database).await;
        let before = a_job(store, &set, "succeed").await;
        run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        let before = jobs::get(store, &before.id).await.unwrap();
        let sweeps = kincal::store::NewFrames {
            robot_id: set.robot_id.clone(),
            content_type: "text/csv".into(),
            body: vec![1].into(),
            result_json: "{}".into(),
        };
        let frames = in_transaction(store, async |tx| frames::insert(tx, &sweeps).await).await;
        let verify = a_set(store, &a_robot(store, "r").await).await;
        let new = NewJob {
            verify_set_id: Some(verify.id.clone()),
            frames_id: Some(frames.id.clone()),
            network_input_id: before.network_id.clone(),
            parameter_set_input_id: before.parameter_set_id.clone(),
            ..new_job(&set, "{}")
        };
        let job = in_transaction(store, async |tx| queue::enqueue(tx, &new).await).await;
        run_next_job(
            store,
            &WorkerContext::new(tell, LONG, JobSignals::default()),
        )
        .await
        .unwrap();
        let problem: kincal::wire::Problem =
            serde_json::from_str(&jobs::get(store, &job.id).await.unwrap().error_json.unwrap())
                .unwrap();
        let problem: serde_json::Value = serde_json::from_str(&problem.detail).unwrap();
        let expected = serde_json::json!({
            "robot": set.robot_id, "status": "running", "set": set.id, "verify_set": (verify.id, b"the bytes"), "frames": frames.id,
            "network": (before.network_id, [0, 1, 255]), "parameter_set": before.parameter_set_id,
        });
        assert_eq!(problem, expected);
    });
}

#[test]
fn a_computation_that_fails_fails_its_job_with_its_problem() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "fail").await;
        run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        let failed = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(failed.status, JobStatus::Failed);
        let told: kincal::wire::Problem =
            serde_json::from_str(&failed.error_json.unwrap()).unwrap();
        assert_eq!(told, *crate::computations::problem());
        assert_eq!((failed.parameter_set_id, failed.network_id), (None, None));
    });
}

#[test]
fn a_computation_that_panics_is_tried_as_often_as_allowed_and_others_go_on() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = some_set(database).await;
        let (first, second) = (
            a_job(store, &set, "panic").await,
            a_job(store, &set, "succeed").await,
        );
        let done = run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        assert_eq!(done, [first.id.clone(), second.id.clone()]);
        assert_eq!(
            jobs::get(store, &second.id).await.unwrap().status,
            JobStatus::Succeeded
        );
        for attempt in 1..=3 {
            let job = jobs::get(store, &first.id).await.unwrap();
            assert_eq!(
                (job.status, job.attempt),
                (JobStatus::Running, attempt),
                "its lease ends at once"
            );
            queue::expire(store, 3, &JobSignals::default())
                .await
                .unwrap();
            run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        }
        let failed = jobs::get(store, &first.id).await.unwrap();
        assert_eq!(
            (failed.status, code(&failed).as_str(), failed.attempt),
            (JobStatus::Failed, "attempts_exhausted", 3)
        );
        assert!(
            !failed.error_json.unwrap().contains("did not expect"),
            "the cause is for the log"
        );
    });
}

#[test]
fn a_computation_without_an_end_is_tried_as_often_as_allowed_and_others_go_on() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = some_set(database).await;
        // One computation checks for cancellation; the other ignores it and keeps its thread.
        for request in ["run until stopped", "report progress, wait at the gate"] {
            let (endless, other) = (
                a_job(store, &set, request).await,
                a_job(store, &set, "succeed").await,
            );
            let mut context = a_worker(LONG);
            context.max_duration = Duration::from_millis(50);
            for attempt in 1..=3 {
                let ran = tokio::time::timeout(LONG / 4, run_pending_jobs(store, &context)).await;
                ran.expect("a computation without an end is given up")
                    .unwrap();
                let job = jobs::get(store, &endless.id).await.unwrap();
                assert_eq!(
                    (job.status, job.attempt),
                    (JobStatus::Running, attempt),
                    "its lease ends at once"
                );
                assert_eq!(
                    jobs::get(store, &other.id).await.unwrap().status,
                    JobStatus::Succeeded
                );
                queue::expire(store, 3, &JobSignals::default())
                    .await
                    .unwrap();
            }
            let failed = jobs::get(store, &endless.id).await.unwrap();
            assert_eq!(
                (failed.status, code(&failed).as_str(), failed.attempt),
                (JobStatus::Failed, "attempts_exhausted", 3)
            );
            // Its threads return too late.
            gate(&endless.id).open();
        }
        assert_eq!(
            parameter_sets::search(store, &set.robot_id, &everything())
                .await
                .unwrap()
                .items
                .len(),
            2
        );
    });
}

#[test]
fn a_computation_that_stops_without_being_told_to_fails_its_job() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "give up").await;
        run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        let failed = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (failed.status, code(&failed).as_str()),
            (JobStatus::Failed, "internal")
        );
    });
}

#[test]
fn a_result_that_cannot_be_stored_fails_its_job_and_leaves_nothing_of_it() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "succeed").await;
        let in_the_way = NewParameterSet {
            body_json: "{}".into(),
            sha256: "00".into(),
            estimate_json: None,
        };
        in_transaction(store, async |tx| {
            parameter_sets::insert(tx, &job.id, &in_the_way).await
        })
        .await;
        run_pending_jobs(store, &a_worker(LONG)).await.unwrap();
        let failed = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (failed.status, code(&failed).as_str()),
            (JobStatus::Failed, "internal")
        );
        assert_eq!((failed.result_sha256, failed.network_id), (None, None));
    });
}

#[test]
fn a_running_job_stops_when_it_is_cancelled() {
    for_each_engine(async |database| {
        let store = &database.store;
        // Once with a signal, and once without, as from another process.
        for signalled in [true, false] {
            let job = a_lone_job(store, "run until stopped").await;
            let context = a_worker(LONG);
            let worker = begin(store, &context);
            arrived(&job.id).await;
            let signals = if signalled {
                context.signals.clone()
            } else {
                JobSignals::default()
            };
            queue::cancel(store, &signals, &job.id, "key_1")
                .await
                .unwrap();
            worker.await.unwrap();
            let cancelled = jobs::get(store, &job.id).await.unwrap();
            assert_eq!(
                (cancelled.status, cancelled.parameter_set_id),
                (JobStatus::Cancelled, None)
            );
        }
    });
}

#[test]
fn a_heartbeat_keeps_the_lease_while_the_computation_is_silent() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "report progress, wait at the gate").await;
        let lease = Duration::from_millis(1500);
        let worker = begin(store, &a_worker(lease));
        arrived(&job.id).await;
        let first = jobs::get(store, &job.id).await.unwrap();
        // After more than the length of a lease it is still the same attempt, although expired leases are collected.
        let later = until(store, &job.id, |now| {
            now.lease_until_ms > first.lease_until_ms.map(|ms| ms + 2000)
        })
        .await;
        assert_eq!(
            queue::expire(store, 3, &JobSignals::default())
                .await
                .unwrap(),
            Default::default()
        );
        let progress: serde_json::Value =
            serde_json::from_str(later.progress_json.as_deref().unwrap()).unwrap();
        assert_eq!(
            (later.attempt, progress),
            (
                1,
                serde_json::json!({"stage": "corrections", "best_cost_mm2": 0.5, "iteration": 3, "n_iterations": 10})
            )
        );
        gate(&job.id).open();
        worker.await.unwrap();
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().status,
            JobStatus::Succeeded
        );
    });
}

#[test]
fn a_worker_that_lost_its_lease_stops_computing_and_writes_nothing() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = some_set(database).await;
        for request in ["run until stopped", "report progress, wait at the gate"] {
            let job = a_job(store, &set, request).await;
            let worker = begin(store, &a_worker(LONG));
            arrived(&job.id).await;
            let taken = "update job set owner = 'another', attempt = 2 where id = $1";
            sqlx::query(taken)
                .bind(&job.id)
                .execute(store.readers())
                .await
                .unwrap();
            // The second computation does not check, and returns its result too late.
            gate(&job.id).open();
            worker.await.unwrap();
            let theirs = jobs::get(store, &job.id).await.unwrap();
            assert_eq!(
                (theirs.status, theirs.owner.as_deref(), theirs.attempt),
                (JobStatus::Running, Some("another"), 2)
            );
        }
        assert_eq!(
            parameter_sets::search(store, &set.robot_id, &everything())
                .await
                .unwrap()
                .items,
            []
        );
        assert_eq!(
            networks::search(store, &set.robot_id, &everything())
                .await
                .unwrap()
                .items,
            []
        );
    });
}

#[test]
fn a_result_survives_a_database_that_is_busy_for_less_than_the_lease() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "report progress, wait at the gate").await;
        let worker = begin(store, &a_worker(LONG));
        arrived(&job.id).await;
        let busy = lock_the_row(store, &job).await;
        gate(&job.id).open();
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().status,
            JobStatus::Running
        );
        busy.rollback().await.unwrap();
        worker.await.unwrap();
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().status,
            JobStatus::Succeeded
        );
    });
}

#[test]
fn a_worker_gives_up_when_the_database_is_away_for_longer_than_the_lease() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "run until stopped").await;
        let worker = begin(store, &a_worker(Duration::from_millis(400)));
        arrived(&job.id).await;
        let away = lock_the_row(store, &job).await;
        // The computation ends although the database does not answer.
        worker.await.unwrap();
        away.rollback().await.unwrap();
        let left = until(store, &job.id, |_| true).await;
        assert_eq!(
            (left.status, left.parameter_set_id),
            (JobStatus::Running, None)
        );
    });
}

/// A transaction that blocks all other writers of this job.
async fn lock_the_row(store: &Store, job: &JobRow) -> kincal::store::Tx {
    let mut tx = store.begin().await.unwrap();
    // Writes the row without a visible change.
    jobs::cancel(&mut tx, &job.id).await.unwrap();
    tx
}

#[test]
fn a_worker_that_is_dropped_holds_no_lease_and_stops_its_computation() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "run until stopped").await;
        let worker = begin(store, &a_worker(Duration::from_millis(300)));
        arrived(&job.id).await;
        worker.abort();
        let expired = async {
            loop {
                let expired = queue::expire(store, 3, &JobSignals::default())
                    .await
                    .unwrap();
                if !expired.queued.is_empty() {
                    return expired.queued;
                }
                tokio::task::yield_now().await;
            }
        };
        assert_eq!(tokio::time::timeout(LONG, expired).await.unwrap(), [job.id]);
    });
}
