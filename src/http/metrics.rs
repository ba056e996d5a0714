//! `/metrics`: counters of this process and the state of the queue, in Prometheus's text format.

use crate::http::auth::Caller;
use crate::http::counters::PrometheusText;
use crate::http::{App, Error};
use crate::store::statistics::{self, JobStatistics};
use crate::wire::job_answer::JobStatus;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

const TEXT_FORMAT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Counters and the state of the queue, in Prometheus's text format. Requires a key that is not limited to robots.
#[utoipa::path(
    get, path = "/metrics", tag = "service", operation_id = "metrics",
    responses((status = 200, description = "Prometheus text format 0.0.4", body = String, content_type = "text/plain"))
)]
pub async fn metrics(State(app): State<App>, caller: Caller) -> Result<Response, Error> {
    if caller.robots.is_some() {
        return Err(Error::Forbidden(
            "the metrics are about all robots; this key is limited to some",
        ));
    }
    let mut out = PrometheusText::default();
    out.family("kincal_build_info", "gauge", "The version that runs.")
        .sample(&[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    app.metrics.write(&mut out);
    let what = "Free permits by kind. At 0 a request is refused, or waits if it computes.";
    let mut permits = out.family("kincal_permits_available", "gauge", what);
    for (kind, left) in app.limits.free() {
        permits.sample(&[("kind", kind)], left as f64);
    }
    // The counters are answered even while the database is unavailable.
    let jobs = {
        let _permit = app.limits.statistics_permit().await?;
        statistics::jobs(&app.store).await
    };
    let is_up = f64::from(u8::from(jobs.is_ok()));
    let what = "1 if the database answered just now.";
    out.gauge("kincal_database_up", what, is_up);
    if let Some(free) = app.store.free_bytes() {
        let what =
            "Free space on the disk of the embedded database; below 64 MiB uploads are refused.";
        out.gauge("kincal_disk_free_bytes", what, free as f64);
    }
    if let Ok(jobs) = jobs {
        write_jobs(&mut out, &jobs);
    }
    Ok(([(header::CONTENT_TYPE, TEXT_FORMAT)], out.0).into_response())
}

fn write_jobs(out: &mut PrometheusText, jobs: &[JobStatistics]) {
    let of = |status: JobStatus| jobs.iter().find(|row| row.status == status);
    let mut n_jobs = out.family("kincal_jobs", "gauge", "Jobs by status.");
    // Every status is listed, even without jobs.
    for status in JobStatus::ALL {
        let n = of(status).map_or(0.0, |row| row.n_jobs as f64);
        n_jobs.sample(&[("status", status.as_str())], n);
    }
    let what = "Since the oldest job of this status was posted.";
    let mut ages = out.family("kincal_oldest_job_age_seconds", "gauge", what);
    for status in [JobStatus::Queued, JobStatus::Running] {
        let age_s = of(status).map_or(0.0, |row| seconds(row.oldest_age_ms));
        ages.sample(&[("status", status.as_str())], age_s);
    }
    let what = "From posting to the beginning, over all jobs in the database.";
    let mut waits = out.family("kincal_job_queue_wait_seconds", "summary", what);
    let waited_s = jobs.iter().map(|row| seconds(row.waited_ms)).sum();
    let n_begun = jobs.iter().map(|row| row.n_begun).sum::<i64>() as f64;
    waits.sample_with_suffix("_sum", &[], waited_s);
    waits.sample_with_suffix("_count", &[], n_begun);
    let what = "From the beginning to the end, over the jobs in the database that succeeded.";
    let mut solves = out.family("kincal_job_solve_seconds", "summary", what);
    let ended = of(JobStatus::Succeeded);
    solves.sample_with_suffix("_sum", &[], ended.map_or(0.0, |row| seconds(row.ran_ms)));
    solves.sample_with_suffix("_count", &[], ended.map_or(0.0, |row| row.n_jobs as f64));
}

fn seconds(ms: i64) -> f64 {
    ms as f64 / 1e3
}
