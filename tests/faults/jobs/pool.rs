//! The worker pool: it runs posted jobs, and shuts down without losing or repeating any.

use std::time::{Duration, Instant};

use kincal::jobs::{AttemptLimits, JobSignals, WorkerPool, queue};
use kincal::store::{JobStatus, jobs, parameter_sets};

use crate::computations::{LONG, arrived, gate, run_scripted, until};
use crate::engines::for_each_engine;
use crate::fixtures::{a_job, a_lone_job, a_robot, a_set, claim, everything};

const RULES: AttemptLimits = AttemptLimits {
    lease: LONG,
    max_attempts: 3,
    max_duration: LONG,
};

#[test]
fn a_pool_runs_every_job_once() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let signals = JobSignals::default();
        let pool = WorkerPool::start(store.clone(), run_scripted, 4, RULES, signals.clone());
        let mut ids = Vec::new();
        for i in 0..40 {
            let request = if i % 10 == 3 { "panic" } else { "succeed" };
            ids.push((a_job(store, &set, request).await.id, i % 10 == 3));
            signals.job_enqueued();
        }
        for (id, panics) in &ids {
            let job = until(store, id, |job| job.status.is_over()).await;
            let expected = if *panics {
                (JobStatus::Failed, i64::from(RULES.max_attempts))
            } else {
                (JobStatus::Succeeded, 1)
            };
            assert_eq!((job.status, job.attempt), expected);
        }
        pool.shutdown(LONG).await;
        let sets = parameter_sets::search(store, &set.robot_id, &everything())
            .await
            .unwrap()
            .items;
        assert_eq!(sets.len(), 36);
    });
}

#[test]
fn a_pool_finds_jobs_that_nobody_signalled() {
    for_each_engine(async |database| {
        let store = &database.store;
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, JobSignals::default());
        // Posted as if by another process.
        let job = a_lone_job(store, "succeed").await;
        assert_eq!(
            until(store, &job.id, |job| job.status.is_over())
                .await
                .status,
            JobStatus::Succeeded
        );
        pool.shutdown(LONG).await;
    });
}

#[test]
fn a_worker_goes_on_with_what_waits_without_a_signal_for_each() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let mut ids = Vec::new();
        for _ in 0..20 {
            ids.push(a_job(store, &set, "succeed").await.id);
        }
        let begun = Instant::now();
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, JobSignals::default());
        for id in &ids {
            assert_eq!(
                until(store, id, |job| job.status.is_over()).await.status,
                JobStatus::Succeeded
            );
        }
        // A pool that only polls would take a second for each.
        assert!(
            begun.elapsed() < Duration::from_secs(10),
            "{:?}",
            begun.elapsed()
        );
        pool.shutdown(LONG).await;
    });
}

#[test]
fn a_pool_forgets_the_idempotency_keys_of_long_ago_and_no_others() {
    for_each_engine(async |database| {
        let store = &database.store;
        for at in ["1", "(select now_ms from clock)"] {
            let sql = format!(
                "insert into idempotency (key_holder, method, path, idempotency_key, request_sha256, created_at_ms)
                 values ('k', 'POST', '/', 'at {at}', 's', {at})"
            );
            sqlx::query(sqlx::AssertSqlSafe(sql))
                .execute(store.readers())
                .await
                .unwrap();
        }
        let pool = WorkerPool::start(store.clone(), run_scripted, 0, RULES, JobSignals::default());
        let remaining = async {
            loop {
                let remaining: Vec<String> =
                    sqlx::query_scalar("select idempotency_key from idempotency")
                        .fetch_all(store.readers())
                        .await
                        .unwrap();
                if remaining.len() < 2 {
                    return remaining;
                }
            }
        };
        assert_eq!(
            tokio::time::timeout(LONG, remaining).await.unwrap(),
            ["at (select now_ms from clock)"]
        );
        pool.shutdown(LONG).await;
    });
}

#[test]
fn a_pool_takes_over_the_job_of_a_worker_that_died() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "succeed").await;
        claim(store, "dead", Duration::from_millis(1))
            .await
            .unwrap();
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, JobSignals::default());
        let done = until(store, &job.id, |job| job.status.is_over()).await;
        assert_eq!((done.status, done.attempt), (JobStatus::Succeeded, 2));
        pool.shutdown(LONG).await;
    });
}

#[test]
fn a_pool_that_shuts_down_lets_computations_finish_in_time() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "report progress, wait at the gate").await;
        let waiting = a_lone_job(store, "succeed").await;
        // The lease is shorter than the draining, so it must be renewed.
        let pool = WorkerPool::start(
            store.clone(),
            run_scripted,
            1,
            AttemptLimits {
                lease: Duration::from_millis(1500),
                ..RULES
            },
            JobSignals::default(),
        );
        arrived(&job.id).await;
        let shutdown = tokio::spawn(pool.shutdown(LONG));
        let begun = jobs::get(store, &job.id).await.unwrap();
        until(store, &job.id, |job| {
            job.lease_until_ms > begun.lease_until_ms.map(|ms| ms + 2000)
        })
        .await;
        gate(&job.id).open();
        shutdown.await.unwrap();
        let done = jobs::get(store, &job.id).await.unwrap();
        assert_eq!((done.status, done.attempt), (JobStatus::Succeeded, 1));
        assert_eq!(
            jobs::get(store, &waiting.id).await.unwrap().status,
            JobStatus::Queued,
            "nothing new was begun"
        );
    });
}

#[test]
fn a_pool_that_shuts_down_hands_unfinished_jobs_back_with_their_attempt() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "run until stopped").await;
        let pool = WorkerPool::start(store.clone(), run_scripted, 2, RULES, JobSignals::default());
        arrived(&job.id).await;
        let begun = Instant::now();
        pool.shutdown(Duration::from_secs(1)).await;
        assert!(
            begun.elapsed() < LONG / 4,
            "the shutdown took {:?}",
            begun.elapsed()
        );
        let handed_back = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (handed_back.status, handed_back.attempt, handed_back.owner),
            (JobStatus::Queued, 0, None)
        );
    });
}

#[test]
fn a_computation_that_does_not_stop_is_handed_back_and_its_late_result_is_not_stored() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let job = a_job(store, &set, "report progress, wait at the gate").await;
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, JobSignals::default());
        arrived(&job.id).await;
        pool.shutdown(Duration::from_secs(1)).await;
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().status,
            JobStatus::Queued
        );
        gate(&job.id).open();
        // Another pool computes the job, once.
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, JobSignals::default());
        let done = until(store, &job.id, |job| job.status.is_over()).await;
        assert_eq!((done.status, done.attempt), (JobStatus::Succeeded, 1));
        pool.shutdown(LONG).await;
        assert_eq!(
            parameter_sets::search(store, &set.robot_id, &everything())
                .await
                .unwrap()
                .items
                .len(),
            1
        );
    });
}

#[test]
fn a_pool_without_work_shuts_down_at_once() {
    for_each_engine(async |database| {
        for n_workers in [0, 3] {
            let pool = WorkerPool::start(
                database.store.clone(),
                run_scripted,
                n_workers,
                RULES,
                JobSignals::default(),
            );
            let begun = Instant::now();
            pool.shutdown(LONG).await;
            assert!(begun.elapsed() < LONG / 2);
        }
    });
}

#[test]
fn a_cancelled_job_is_over_soon_though_its_computation_does_not_look_and_its_worker_takes_no_other_until_it_ends()
 {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let signals = JobSignals::default();
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, RULES, signals.clone());
        let unresponsive = a_job(store, &set, "report progress, wait at the gate").await;
        signals.job_enqueued();
        arrived(&unresponsive.id).await;
        let next = a_job(store, &set, "succeed").await;
        signals.job_enqueued();
        let started = Instant::now();
        queue::cancel(store, &signals, &unresponsive.id, "anybody")
            .await
            .unwrap();
        let over = until(store, &unresponsive.id, |job| job.status.is_over()).await;
        assert_eq!(over.status, JobStatus::Cancelled);
        assert!(started.elapsed() < LONG / 10, "{:?}", started.elapsed());
        // More than enough time to claim it.
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(
            jobs::get(store, &next.id).await.unwrap().status,
            JobStatus::Queued,
            "one worker computes one job at a time"
        );
        gate(&unresponsive.id).open();
        assert_eq!(
            until(store, &next.id, |job| job.status.is_over())
                .await
                .status,
            JobStatus::Succeeded
        );
        assert_eq!(
            jobs::get(store, &unresponsive.id).await.unwrap().status,
            JobStatus::Cancelled,
            "what it gave in the end is nobody's"
        );
        // A pool that shuts down does not wait for such a thread.
        let unresponsive = a_job(store, &set, "report progress, wait at the gate").await;
        signals.job_enqueued();
        arrived(&unresponsive.id).await;
        queue::cancel(store, &signals, &unresponsive.id, "anybody")
            .await
            .unwrap();
        until(store, &unresponsive.id, |job| job.status.is_over()).await;
        let started = Instant::now();
        pool.shutdown(LONG).await;
        assert!(started.elapsed() < LONG / 10, "{:?}", started.elapsed());
        gate(&unresponsive.id).open();
    });
}

#[test]
fn a_cancelled_computation_without_an_end_keeps_its_worker_no_longer_than_a_job_may_take() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let signals = JobSignals::default();
        let rules = AttemptLimits {
            max_duration: Duration::from_secs(1),
            ..RULES
        };
        let pool = WorkerPool::start(store.clone(), run_scripted, 1, rules, signals.clone());
        let unresponsive = a_job(store, &set, "report progress, wait at the gate").await;
        signals.job_enqueued();
        arrived(&unresponsive.id).await;
        queue::cancel(store, &signals, &unresponsive.id, "anybody")
            .await
            .unwrap();
        let (next, started) = (a_job(store, &set, "succeed").await, Instant::now());
        signals.job_enqueued();
        assert_eq!(
            until(store, &next.id, |job| job.status.is_over())
                .await
                .status,
            JobStatus::Succeeded
        );
        // The gate would time out later.
        assert!(started.elapsed() < LONG / 4, "{:?}", started.elapsed());
        assert_eq!(
            jobs::get(store, &unresponsive.id).await.unwrap().status,
            JobStatus::Cancelled
        );
        pool.shutdown(LONG).await;
        gate(&unresponsive.id).open();
    });
}

/// Expires the leases of these jobs, as if their process had died.
async fn expire_leases_of(store: &kincal::store::Store, ids: &[&str]) {
    for id in ids {
        let lost = "update job set lease_until_ms = 1, owner = 'dead' where id = $1 and status = 'running'";
        let done = sqlx::query(lost).bind(*id).execute(store.readers()).await;
        assert_eq!(done.unwrap().rows_affected(), 1);
    }
    queue::expire(store, 3, &JobSignals::default())
        .await
        .unwrap();
}

#[test]
fn jobs_under_which_a_process_died_run_alone_one_after_the_other_and_after_all_others() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let at_the_gate = "report progress, wait at the gate";
        let (first, second) = (
            a_job(store, &set, at_the_gate).await.id,
            a_job(store, &set, at_the_gate).await.id,
        );
        for _ in 0..2 {
            claim(store, "dead", LONG).await.unwrap();
        }
        expire_leases_of(store, &[&first, &second]).await;
        let other = a_job(store, &set, at_the_gate).await.id;

        let signals = JobSignals::default();
        let pool = WorkerPool::start(store.clone(), run_scripted, 4, RULES, signals.clone());
        arrived(&other).await;
        let status = async |id: &str| jobs::get(store, id).await.unwrap().status;
        assert_eq!(
            [status(&first).await, status(&second).await],
            [JobStatus::Queued; 2],
            "nothing suspected runs beside another job"
        );
        gate(&other).open();
        arrived(&first).await;
        // A job that is posted while a suspect runs waits, although three workers are idle.
        let late = a_job(store, &set, "succeed").await.id;
        signals.job_enqueued();
        let renewed = jobs::get(store, &first).await.unwrap().lease_until_ms;
        until(store, &first, |job| {
            job.lease_until_ms > renewed.map(|ms| ms + 2000)
        })
        .await;
        assert_eq!(
            [status(&second).await, status(&late).await],
            [JobStatus::Queued; 2],
            "a suspect has its process for itself"
        );
        gate(&first).open();
        let late = until(store, &late, |job| job.status.is_over()).await;
        arrived(&second).await;
        gate(&second).open();
        let second = until(store, &second, |job| job.status.is_over()).await;
        assert_eq!(
            (late.status, second.status, second.attempt),
            (JobStatus::Succeeded, JobStatus::Succeeded, 2)
        );
        assert!(late.finished_at_ms <= second.started_at_ms, "others first");
        pool.shutdown(LONG).await;
    });
}

#[test]
fn a_suspect_has_its_turn_though_other_jobs_keep_coming() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let suspect = a_job(store, &set, "succeed").await.id;
        claim(store, "dead", LONG).await.unwrap();
        expire_leases_of(store, &[&suspect]).await;
        let signals = JobSignals::default();
        let rules = AttemptLimits {
            lease: Duration::from_secs(1),
            ..RULES
        };
        // Two jobs run and two wait at any moment until the suspect has run.
        let mut others = std::collections::VecDeque::new();
        for _ in 0..4 {
            others.push_back(a_job(store, &set, "run until stopped").await.id);
        }
        let pool = WorkerPool::start(store.clone(), run_scripted, 2, rules, signals.clone());
        arrived(&others[0]).await;
        let has_turn = async {
            while jobs::get(store, &suspect).await.unwrap().status == JobStatus::Queued {
                others.push_back(a_job(store, &set, "run until stopped").await.id);
                signals.job_enqueued();
                if others.len() > 4 {
                    let oldest = others.pop_front().unwrap();
                    queue::cancel(store, &signals, &oldest, "key_1")
                        .await
                        .unwrap();
                    until(store, &oldest, |job| job.status.is_over()).await;
                }
            }
        };
        tokio::time::timeout(LONG, has_turn)
            .await
            .expect("the suspect starves");
        for id in others {
            queue::cancel(store, &signals, &id, "key_1").await.unwrap();
        }
        let done = until(store, &suspect, |job| job.status.is_over()).await;
        assert_eq!(done.status, JobStatus::Succeeded);
        pool.shutdown(LONG).await;
    });
}
