//! The queue: the order of claims, and fencing of workers that lost a job.

use std::collections::HashSet;
use std::time::Duration;

use kincal::jobs::queue::{self, AttemptEnd};
use kincal::jobs::{JobOutcome, JobSignals};
use kincal::store::{
    Conflict, Error, JobStatus, Lease, NewJob, NewParameterSet, Result, Store, jobs, leases,
    parameter_sets,
};
use kincal::wire::job::Method;

use crate::computations::LONG;
use crate::engines::for_each_engine;
use crate::fixtures::{
    self, a_job, a_lone_job, a_robot, a_set, everything, in_transaction, new_job,
};

async fn claim(store: &Store, owner: &str) -> Lease {
    fixtures::claim(store, owner, LONG)
        .await
        .expect("a job waits")
}

/// How many jobs are queued, and how many are running.
async fn queued_and_running(store: &Store) -> (i64, i64) {
    let count = async |status: &'static str| {
        sqlx::query_scalar("select count(*) from job where status = $1")
            .bind(status)
            .fetch_one(store.readers())
            .await
            .unwrap()
    };
    (count("queued").await, count("running").await)
}

/// Expires this lease.
async fn wait_until_expired(store: &Store, lease: &Lease) {
    sqlx::query("update job set lease_until_ms = 1 where id = $1")
        .bind(&lease.job_id)
        .execute(store.readers())
        .await
        .unwrap();
}

async fn expire(store: &Store) -> (Vec<String>, Vec<String>, Vec<String>) {
    let expired = queue::expire(store, 3, &JobSignals::default())
        .await
        .unwrap();
    (expired.queued, expired.failed, expired.cancelled)
}

fn an_outcome(report_json: &str) -> JobOutcome {
    JobOutcome {
        report_json: report_json.to_owned().into(),
        summary_json: "{}".into(),
        convergence_json: "{}".to_owned().into(),
        result_sha256: "ab".into(),
        parameter_set: Some(NewParameterSet {
            body_json: "{}".into(),
            sha256: "cd".into(),
            estimate_json: None,
        }),
        network: None,
        residual_network: None,
        verification: None,
    }
}

async fn finish(store: &Store, lease: &Lease, report_json: &str) -> Result<()> {
    let outcome = Box::new(an_outcome(report_json));
    queue::end(store, lease, &AttemptEnd::Finished(outcome)).await
}

fn is_lost<T: std::fmt::Debug>(result: &Result<T>) -> bool {
    matches!(result, Err(Error::Conflict(Conflict::LeaseLost)))
}

/// Every operation of a worker on a job.
async fn assert_all_refused(store: &Store, lease: &Lease) {
    assert!(is_lost(
        &leases::heartbeat(store, lease, LONG, Some("{}")).await
    ));
    for end in [
        AttemptEnd::Finished(Box::new(an_outcome("stale"))),
        AttemptEnd::Failed(crate::computations::problem()),
        AttemptEnd::Cancelled,
        AttemptEnd::HandedBack,
        AttemptEnd::GaveUp,
    ] {
        assert!(is_lost(&queue::end(store, lease, &end).await), "{end:?}");
    }
}

#[test]
fn a_posted_job_waits_with_what_was_asked() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let verify = a_set(store, &a_robot(store, "other").await).await;
        let new = NewJob {
            verify_set_id: Some(verify.id),
            priority: 5,
            ..new_job(&set, r#"{"seed":1}"#)
        };
        let job = in_transaction(store, async |tx| queue::enqueue(tx, &new).await).await;
        assert_eq!(
            (job.status, job.attempt, job.priority),
            (JobStatus::Queued, 0, 5)
        );
        assert_eq!(
            (&job.request_json, &job.verify_set_id),
            (&new.request_json, &new.verify_set_id)
        );
        assert_eq!(
            (job.owner.as_deref(), job.started_at_ms, job.finished_at_ms),
            (None, None, None)
        );
        assert_eq!(jobs::get(store, &job.id).await.unwrap(), job);
        assert_eq!(
            jobs::search(store, &set.robot_id, &everything())
                .await
                .unwrap()
                .items,
            [job]
        );
        assert_eq!(queued_and_running(store).await, (1, 0));
    });
}

#[test]
fn two_workers_never_get_the_same_job() {
    for_each_engine(async |database| {
        let set = a_set(&database.store, &a_robot(&database.store, "r").await).await;
        for _ in 0..60 {
            a_job(&database.store, &set, "{}").await;
        }
        let workers: Vec<_> = (0..8)
            .map(|worker| {
                let store = database.store.clone();
                tokio::spawn(async move {
                    let mut claimed = Vec::new();
                    let owner = format!("worker {worker}");
                    while let Some(lease) = fixtures::claim(&store, &owner, LONG).await {
                        claimed.push(lease.job_id);
                    }
                    claimed
                })
            })
            .collect();
        let mut all = Vec::new();
        for worker in workers {
            all.extend(worker.await.unwrap());
        }
        assert_eq!(all.len(), 60);
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), 60);
        assert_eq!(queued_and_running(&database.store).await, (0, 60));
    });
}

#[test]
fn the_highest_priority_goes_first_and_of_those_the_oldest() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let mut posted = Vec::new();
        for priority in [0, 0, 7, 0, 7] {
            let new = NewJob {
                priority,
                ..new_job(&set, "{}")
            };
            posted.push(
                in_transaction(store, async |tx| queue::enqueue(tx, &new).await)
                    .await
                    .id,
            );
        }
        for expected in [2, 4, 0, 1, 3] {
            assert_eq!(claim(store, "w").await.job_id, posted[expected]);
        }
        assert_eq!(fixtures::claim(store, "w", LONG).await, None);
    });
}

#[test]
fn a_lease_lasts_as_long_as_it_was_asked_for_and_from_each_heartbeat_anew() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        let before_ms = store.now_ms().await.unwrap();
        let lease = claim(store, "w").await;
        let claimed = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (claimed.status, claimed.attempt, claimed.owner.as_deref()),
            (JobStatus::Running, 1, Some("w"))
        );
        let after_ms = store.now_ms().await.unwrap();
        assert!(
            (before_ms + 60_000..=after_ms + 60_000).contains(&claimed.lease_until_ms.unwrap())
        );
        assert!((before_ms..=after_ms).contains(&claimed.started_at_ms.unwrap()));
        leases::heartbeat(store, &lease, 2 * LONG, Some("1"))
            .await
            .unwrap();
        leases::heartbeat(store, &lease, 2 * LONG, None)
            .await
            .unwrap();
        let renewed = jobs::get(store, &job.id).await.unwrap();
        assert!(renewed.lease_until_ms.unwrap() >= after_ms + 120_000);
        assert_eq!(
            renewed.progress_json.as_deref(),
            Some("1"),
            "a heartbeat without progress keeps the last one"
        );
    });
}

#[test]
fn after_a_lease_ran_out_the_job_is_begun_again_and_its_first_worker_can_do_nothing() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        let stale = claim(store, "stopped").await;
        leases::heartbeat(store, &stale, LONG, Some("1"))
            .await
            .unwrap();
        assert_eq!(
            expire(store).await,
            (vec![], vec![], vec![]),
            "the lease holds"
        );
        wait_until_expired(store, &stale).await;
        assert_eq!(expire(store).await, (vec![job.id.clone()], vec![], vec![]));
        let waiting = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(
            (waiting.status, waiting.progress_json, waiting.started_at_ms),
            (JobStatus::Queued, None, None)
        );
        assert_all_refused(store, &stale).await;
        let second = claim(store, "alive").await;
        assert_eq!(
            (second.job_id.as_str(), second.attempt),
            (job.id.as_str(), 2)
        );
        assert_all_refused(store, &stale).await;
        // The old lease does nothing either if the same worker has claimed the job again.
        assert_all_refused(
            store,
            &Lease {
                attempt: 1,
                ..second.clone()
            },
        )
        .await;
        assert_all_refused(
            store,
            &Lease {
                owner: "stopped".into(),
                ..second.clone()
            },
        )
        .await;
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().parameter_set_id,
            None
        );
        finish(store, &second, "fresh").await.unwrap();
        assert_all_refused(store, &stale).await;
        assert_eq!(jobs::report(store, &job.id).await.unwrap(), "fresh");
    });
}

#[test]
fn a_job_is_finished_once() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "w").await;
        let finishes: Vec<_> = (0..8)
            .map(|i| {
                let (store, lease) = (store.clone(), lease.clone());
                tokio::spawn(async move { finish(&store, &lease, &i.to_string()).await })
            })
            .collect();
        let mut n_finished = 0;
        for finish in finishes {
            match finish.await.unwrap() {
                Ok(()) => n_finished += 1,
                lost => assert!(is_lost(&lost), "{lost:?}"),
            }
        }
        assert_eq!(n_finished, 1);
        let sets = parameter_sets::search(store, &job.robot_id, &everything())
            .await
            .unwrap()
            .items;
        assert_eq!(sets.len(), 1);
        assert_eq!(
            jobs::get(store, &job.id)
                .await
                .unwrap()
                .parameter_set_id
                .as_ref(),
            Some(&sets[0].id)
        );
    });
}

#[test]
fn of_a_finish_that_fails_halfway_nothing_is_stored() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "w").await;
        let in_the_way = NewParameterSet {
            body_json: "{}".into(),
            sha256: "00".into(),
            estimate_json: None,
        };
        in_transaction(store, async |tx| {
            parameter_sets::insert(tx, &job.id, &in_the_way).await
        })
        .await;
        assert!(matches!(
            finish(store, &lease, "x").await,
            Err(Error::Conflict(Conflict::Duplicate))
        ));
        assert_eq!(
            jobs::get(store, &job.id).await.unwrap().status,
            JobStatus::Running
        );
        let report = jobs::report(store, &job.id).await;
        assert!(
            matches!(
                report,
                Err(Error::Conflict(Conflict::JobStatus {
                    status: JobStatus::Running
                }))
            ),
            "{report:?}"
        );
    });
}

#[test]
fn a_job_whose_attempts_are_used_up_fails_and_says_so() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        for attempt in 1..=3 {
            let lease = claim(store, "panics").await;
            assert_eq!(lease.attempt, attempt);
            queue::end(store, &lease, &AttemptEnd::GaveUp)
                .await
                .unwrap();
            let (queued, failed, _) = expire(store).await;
            let expected = if attempt < 3 {
                (vec![job.id.clone()], vec![])
            } else {
                (vec![], vec![job.id.clone()])
            };
            assert_eq!((queued, failed), expected);
        }
        let failed = jobs::get(store, &job.id).await.unwrap();
        assert_eq!(failed.status, JobStatus::Failed);
        assert!(failed.finished_at_ms.is_some());
        let error: serde_json::Value = serde_json::from_str(&failed.error_json.unwrap()).unwrap();
        assert_eq!(
            (&error["code"], &error["status"]),
            (&"attempts_exhausted".into(), &500.into())
        );
        assert_eq!(fixtures::claim(store, "w", LONG).await, None);
    });
}

#[test]
fn a_job_handed_back_has_its_attempt_again() {
    for_each_engine(async |database| {
        let store = &database.store;
        a_lone_job(&database.store, "{}").await;
        for _ in 0..5 {
            let lease = claim(store, "leaves").await;
            assert_eq!(lease.attempt, 1);
            queue::end(store, &lease, &AttemptEnd::HandedBack)
                .await
                .unwrap();
            assert_all_refused(store, &lease).await;
        }
    });
}

#[test]
fn a_waiting_job_is_cancelled_at_once_and_a_running_one_hears_of_it() {
    for_each_engine(async |database| {
        let (store, signals) = (&database.store, JobSignals::default());
        let waiting = a_lone_job(&database.store, "{}").await;
        let cancelled = queue::cancel(store, &signals, &waiting.id, "key_1")
            .await
            .unwrap();
        assert_eq!(cancelled.status, JobStatus::Cancelled);
        assert!(cancelled.finished_at_ms.is_some());
        assert_eq!(fixtures::claim(store, "w", LONG).await, None);
        assert_eq!(
            queue::cancel(store, &signals, &waiting.id, "key_1")
                .await
                .unwrap(),
            cancelled,
            "again changes nothing"
        );

        let running = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "w").await;
        assert!(
            !leases::heartbeat(store, &lease, LONG, None)
                .await
                .unwrap()
                .cancel_requested
        );
        assert_eq!(
            queue::cancel(store, &signals, &running.id, "key_1")
                .await
                .unwrap()
                .status,
            JobStatus::Running
        );
        assert!(
            leases::heartbeat(store, &lease, LONG, None)
                .await
                .unwrap()
                .cancel_requested
        );
        queue::end(store, &lease, &AttemptEnd::Cancelled)
            .await
            .unwrap();
        assert_eq!(
            jobs::get(store, &running.id).await.unwrap().status,
            JobStatus::Cancelled
        );

        // It ended before its worker learnt of the cancellation.
        let unheard = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "w").await;
        queue::cancel(store, &signals, &unheard.id, "key_1")
            .await
            .unwrap();
        finish(store, &lease, "too late").await.unwrap();
        let cancelled = jobs::get(store, &unheard.id).await.unwrap();
        assert_eq!(
            (
                cancelled.status,
                cancelled.parameter_set_id,
                cancelled.result_sha256
            ),
            (JobStatus::Cancelled, None, None)
        );
        assert!(
            jobs::report(store, &unheard.id).await.is_err()
                && jobs::convergence(store, &unheard.id).await.is_err()
        );

        let failing = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "w").await;
        queue::cancel(store, &signals, &failing.id, "key_1")
            .await
            .unwrap();
        queue::end(
            store,
            &lease,
            &AttemptEnd::Failed(crate::computations::problem()),
        )
        .await
        .unwrap();
        let cancelled = jobs::get(store, &failing.id).await.unwrap();
        assert_eq!(
            (cancelled.status, cancelled.error_json),
            (JobStatus::Cancelled, None)
        );

        let finished = a_lone_job(&database.store, "{}").await;
        finish(store, &claim(store, "w").await, "done")
            .await
            .unwrap();
        assert_eq!(
            queue::cancel(store, &signals, &finished.id, "key_1")
                .await
                .unwrap()
                .status,
            JobStatus::Succeeded
        );
        assert!(matches!(
            queue::cancel(store, &signals, "job_0", "key_1").await,
            Err(Error::NotFound)
        ));
    });
}

#[test]
fn a_cancelled_job_is_not_begun_again_when_its_worker_dies_or_leaves() {
    for_each_engine(async |database| {
        let (store, signals) = (&database.store, JobSignals::default());
        let orphan = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "dies").await;
        queue::cancel(store, &signals, &orphan.id, "key_1")
            .await
            .unwrap();
        wait_until_expired(store, &lease).await;
        assert_eq!(
            expire(store).await,
            (vec![], vec![], vec![orphan.id.clone()])
        );
        assert_eq!(
            jobs::get(store, &orphan.id).await.unwrap().status,
            JobStatus::Cancelled
        );

        let left = a_lone_job(&database.store, "{}").await;
        let lease = claim(store, "leaves").await;
        queue::cancel(store, &signals, &left.id, "key_1")
            .await
            .unwrap();
        queue::end(store, &lease, &AttemptEnd::HandedBack)
            .await
            .unwrap();
        assert_eq!(
            jobs::get(store, &left.id).await.unwrap().status,
            JobStatus::Cancelled
        );
    });
}

#[test]
fn a_robot_has_ten_thousand_jobs_waiting_and_no_more() {
    const FILL: &str = "
        with recursive n(i) as (select 1 union all select i + 1 from n where i < 9999)
        insert into job (id, robot_id, measurement_set_id, kind, method, request_json, status, priority, attempt, created_at_ms)
        select 'job_' || n.i, job.robot_id, job.measurement_set_id, 'identify', 'auto', '{}', 'queued', 0, 0, 0 from n, job where job.id = $1";
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        sqlx::query(FILL)
            .bind(&job.id)
            .execute(store.readers())
            .await
            .unwrap();
        assert_eq!(queued_and_running(store).await, (10_000, 0));
        let new = NewJob {
            robot_id: job.robot_id.clone(),
            set_ids: vec![job.measurement_set_id.clone()],
            ..some_new_job()
        };
        let mut tx = store.begin().await.unwrap();
        let refused = queue::enqueue(&mut tx, &new).await;
        assert!(
            matches!(
                refused,
                Err(Error::Conflict(Conflict::QueueFull { limit: 10_000 }))
            ),
            "{refused:?}"
        );
        tx.rollback().await.unwrap();
        a_lone_job(&database.store, "{}").await;
        claim(store, "w").await;
        in_transaction(store, async |tx| queue::enqueue(tx, &new).await).await;
    });
}

fn some_new_job() -> NewJob {
    NewJob {
        kind: kincal::wire::job::Kind::Identify,
        method: Method::Auto,
        request_json: "{}".into(),
        ..NewJob::default()
    }
}

#[test]
fn a_job_of_a_transaction_that_is_rolled_back_was_never_there() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let mut tx = store.begin().await.unwrap();
        queue::enqueue(&mut tx, &new_job(&set, "{}")).await.unwrap();
        drop(tx);
        assert_eq!(
            fixtures::claim(store, "w", Duration::from_secs(1)).await,
            None
        );
    });
}

#[test]
fn a_job_under_which_the_process_died_is_tried_last_and_not_for_ever() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        for death in 0..=leases::MAX_DEATHS_ALONE {
            // All others are claimed first, whenever they were posted.
            let innocent = a_lone_job(&database.store, "{}").await;
            if death > 0 {
                assert_eq!(claim(store, "w").await.job_id, innocent.id);
            }
            let lease = claim(store, "w").await;
            assert_eq!((&lease.job_id, lease.attempt), (&job.id, death + 1));
            wait_until_expired(store, &lease).await;
            let one = vec![job.id.clone()];
            let (queued, failed) = if death < leases::MAX_DEATHS_ALONE {
                (one, vec![])
            } else {
                (vec![], one)
            };
            assert_eq!(expire(store).await, (queued, failed, vec![]));
            if death == 0 {
                assert_eq!(claim(store, "w").await.job_id, innocent.id);
            }
        }
    });
}

#[test]
fn a_death_uses_up_no_attempt_and_an_attempt_counts_as_no_death() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(&database.store, "{}").await;
        // Three attempts of the job itself.
        for used_up in 1..=3 {
            let lease = claim(store, "its process dies").await;
            wait_until_expired(store, &lease).await;
            assert_eq!(expire(store).await.0, std::slice::from_ref(&job.id));
            let lease = claim(store, "it panics").await;
            queue::end(store, &lease, &AttemptEnd::GaveUp)
                .await
                .unwrap();
            let (queued, failed, _) = expire(store).await;
            assert_eq!(
                (queued.len(), failed.len()),
                if used_up < 3 { (1, 0) } else { (0, 1) }
            );
        }
    });
}

#[test]
fn clients_are_served_in_turn_however_many_jobs_one_of_them_posts() {
    for_each_engine(async |database| {
        let store = &database.store;
        let set = a_set(store, &a_robot(store, "r").await).await;
        let post = async |client: &str| {
            let new = NewJob {
                client: client.into(),
                ..new_job(&set, "{}")
            };
            in_transaction(store, async |tx| queue::enqueue(tx, &new).await)
                .await
                .id
        };
        for _ in 0..50 {
            post("many").await;
        }
        let next = async || claim(store, "w").await.job_id;
        for _ in 0..20 {
            next().await;
        }
        let first = post("few").await;
        let second = post("few").await;
        let served: Vec<String> = [next().await, next().await, next().await, next().await].into();
        assert!(
            served[..2].contains(&first),
            "the first job of a client that comes later is among the next two"
        );
        assert!(served.contains(&second), "its second among the next four");
        // A new client does not overtake clients that have waited.
        let third = post("late").await;
        let served: Vec<String> = [next().await, next().await].into();
        assert!(served.contains(&third));
    });
}
