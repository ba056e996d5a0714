//! Long polls and event streams receive every change.

use std::time::{Duration, Instant};

use kincal::jobs::{JobSignals, WorkerContext, queue, run_next_job};
use kincal::store::{Error, JobStatus, jobs};

use crate::computations::{LONG, arrived, gate, run_scripted};
use crate::engines::for_each_engine;
use crate::fixtures::a_lone_job;

#[test]
fn an_event_stream_sees_begin_progress_and_end() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "report progress, wait at the gate").await;
        let signals = JobSignals::default();
        let context = WorkerContext::new(run_scripted, LONG, signals.clone());
        let worker = tokio::spawn({
            let store = store.clone();
            async move { run_next_job(&store, &context).await.unwrap() }
        });
        let mut seen = job.clone();
        let mut stages = Vec::new();
        while !seen.status.is_over() {
            let next = signals
                .wait_for_change(store, &seen.id, LONG, |job| job.has_progressed_since(&seen))
                .await
                .unwrap();
            assert_ne!(
                (next.status, &next.progress_json),
                (seen.status, &seen.progress_json),
                "an event without news"
            );
            stages.push((next.status, next.progress_json.is_some()));
            if next.progress_json.is_some() {
                gate(&job.id).open();
            }
            seen = next;
        }
        worker.await.unwrap();
        assert!(stages.contains(&(JobStatus::Running, true)), "{stages:?}");
        assert_eq!(stages.last(), Some(&(JobStatus::Succeeded, true)));
    });
}

#[test]
fn a_long_poll_does_not_end_for_progress_but_for_a_status() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "report progress, wait at the gate").await;
        let signals = JobSignals::default();
        let context = WorkerContext::new(run_scripted, LONG, signals.clone());
        let worker = tokio::spawn({
            let store = store.clone();
            async move { run_next_job(&store, &context).await.unwrap() }
        });
        arrived(&job.id).await;
        let poll = tokio::spawn({
            let (store, signals, id) = (store.clone(), signals.clone(), job.id.clone());
            async move {
                signals
                    .wait_for_change(&store, &id, LONG, |job| job.status != JobStatus::Running)
                    .await
                    .unwrap()
            }
        });
        // Progress is written at the same time.
        let running = jobs::get(store, &job.id).await.unwrap();
        if running.progress_json.is_none() {
            signals
                .wait_for_change(store, &job.id, LONG, |job| {
                    job.has_progressed_since(&running)
                })
                .await
                .unwrap();
        }
        assert!(!poll.is_finished());
        gate(&job.id).open();
        assert_eq!(poll.await.unwrap().status, JobStatus::Succeeded);
        worker.await.unwrap();
    });
}

#[test]
fn a_long_poll_hears_of_what_another_process_does() {
    for_each_engine(async |database| {
        let store = &database.store;
        let job = a_lone_job(store, "{}").await;
        let poll = tokio::spawn({
            let (store, id) = (store.clone(), job.id.clone());
            async move {
                JobSignals::default()
                    .wait_for_change(&store, &id, LONG, |job| job.status != JobStatus::Queued)
                    .await
                    .unwrap()
            }
        });
        queue::cancel(store, &JobSignals::default(), &job.id, "key_1")
            .await
            .unwrap();
        assert_eq!(poll.await.unwrap().status, JobStatus::Cancelled);
    });
}

#[test]
fn a_long_poll_ends_at_once_for_a_job_that_is_over_and_in_time_for_one_that_is_not() {
    for_each_engine(async |database| {
        let (store, signals) = (&database.store, JobSignals::default());
        let job = a_lone_job(store, "{}").await;
        let begun = Instant::now();
        let wait = Duration::from_millis(50);
        let unchanged = signals
            .wait_for_change(store, &job.id, wait, |job| job.status != JobStatus::Queued)
            .await
            .unwrap();
        assert_eq!(unchanged, job);
        assert!(begun.elapsed() >= wait);
        queue::cancel(store, &signals, &job.id, "key_1")
            .await
            .unwrap();
        let over = signals
            .wait_for_change(store, &job.id, LONG, |job| {
                job.status != JobStatus::Cancelled
            })
            .await
            .unwrap();
        assert_eq!(over.status, JobStatus::Cancelled);
        assert!(begun.elapsed() < LONG / 2);
        let missing = signals
            .wait_for_change(store, "job_0", LONG, |job| job.status != JobStatus::Queued)
            .await;
        assert!(matches!(missing, Err(Error::NotFound)), "{missing:?}");
    });
}
