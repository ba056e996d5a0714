//! Jobs: status, report, cancellation.

use crate::http::auth::Caller;
use crate::http::extract::{Item, Query};
use crate::http::list_query::{AllJobsQuery, JobListQuery, list_of_robot};
use crate::http::{App, Error, access};
use crate::jobs::queue;
use crate::store::{self, JobRow, jobs};
use crate::wire::job::JobRequestBody;
use crate::wire::job_answer::JobAnswer;
use crate::wire::page::Page;
use crate::wire::report_shape::{Convergence, Report};
use crate::wire::time::rfc3339;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use std::time::Duration;
use utoipa::IntoParams;

/// Longest long poll, seconds. Proxies close silent connections after 60.
const MAX_WAIT_S: u64 = 30;

/// Query of a job.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct WaitQuery {
    /// Wait up to this many seconds for the status to change.
    #[param(minimum = 0, maximum = 30)]
    wait_s: Option<u64>,
}

impl WaitQuery {
    /// Whether the answer may come later.
    pub(super) fn waits(&self) -> bool {
        self.wait_s.is_some_and(|wait_s| wait_s > 0)
    }
}

list_of_robot! {
    /// A robot's jobs.
    list: "/v1/robots/{robot_id}/jobs" "jobs" "listJobs", JobListQuery JobAnswer, jobs::search
}

/// The jobs of all robots that the key may see.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", operation_id = "listAllJobs", params(AllJobsQuery),
    responses((status = 200, description = "One page", body = Page<JobAnswer>))
)]
pub async fn list_all(
    State(app): State<App>,
    caller: Caller,
    Query(mut query): Query<AllJobsQuery>,
) -> Result<Json<Page<JobAnswer>>, Error> {
    let found = match query.robot_id.take() {
        Some(robot_id) => {
            access::robot(&app, &caller, &robot_id).await?;
            jobs::search(&app.store, &robot_id, &query.request()?).await?
        }
        None => jobs::search_all(&app.store, caller.robots.as_deref(), &query.request()?).await?,
    };
    Ok(Json(found.into_answer()?))
}

/// A job. With `wait_s` the answer comes when the status changes or the job ends, at the latest after `wait_s` seconds.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs", operation_id = "getJob", params(("id" = String, Path, description = "The job"), WaitQuery),
    responses((status = 200, description = "The job", body = JobAnswer))
)]
pub async fn get(
    Item { app, caller, id }: Item,
    Query(query): Query<WaitQuery>,
) -> Result<Json<JobAnswer>, Error> {
    let wait_s = query.wait_s.unwrap_or(0);
    if wait_s > MAX_WAIT_S {
        let detail = format!("wait_s is {wait_s}; 0 to {MAX_WAIT_S} is allowed");
        return Err(Error::invalid_query(detail));
    }
    let _permit = query
        .waits()
        .then(|| app.limits.waiting_permit())
        .transpose()?;
    let row = access::job(&app, &caller, &id).await?;
    let row = if query.waits() && !row.status.is_over() {
        wait(&app, row, Duration::from_secs(wait_s)).await?
    } else {
        row
    };
    Ok(Json(JobAnswer::try_from(&row)?))
}

/// Returns the job when its status changes, the time is over, or the server stops.
async fn wait(app: &App, row: JobRow, timeout: Duration) -> Result<JobRow, store::Error> {
    let has_changed = |job: &JobRow| job.status != row.status;
    tokio::select! {
        changed = app.signals.wait_for_change(&app.store, &row.id, timeout, has_changed) => changed,
        () = app.stopped() => jobs::get(&app.store, &row.id).await,
    }
}

/// Cancels a job: at once if it is queued, within a second if it runs. A finished job stays as it is.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", operation_id = "cancelJob", params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job", body = JobAnswer))
)]
pub async fn cancel(Item { app, caller, id }: Item) -> Result<Json<JobAnswer>, Error> {
    access::job(&app, &caller, &id).await?;
    let _permit = app.limits.compute_permit(caller.class).await?;
    Ok(Json(JobAnswer::try_from(
        &queue::cancel(&app.store, &app.signals, &id, &caller.holder).await?,
    )?))
}

/// The report of a job that succeeded.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/report", tag = "jobs", operation_id = "getReport", params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The report", body = Report))
)]
pub async fn report(Item { app, caller, id }: Item) -> Result<Response, Error> {
    let _permit = app.limits.compute_permit(caller.class).await?;
    access::job(&app, &caller, &id).await?;
    Ok(stored(jobs::report(&app.store, &id).await?))
}

/// The smallest cost at each iteration.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/convergence", tag = "jobs", operation_id = "getConvergence", params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The curve", body = Convergence))
)]
pub async fn convergence(Item { app, caller, id }: Item) -> Result<Response, Error> {
    let _permit = app.limits.compute_permit(caller.class).await?;
    access::job(&app, &caller, &id).await?;
    Ok(stored(jobs::convergence(&app.store, &id).await?))
}

fn stored(json: String) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], json).into_response()
}

impl TryFrom<&JobRow> for JobAnswer {
    type Error = Error;

    fn try_from(row: &JobRow) -> Result<Self, Error> {
        let request: JobRequestBody = serde_json::from_str(&row.request_json)?;
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            measurement_set_id: row.measurement_set_id.clone(),
            kind: request.kind,
            method: request.method,
            request,
            status: row.status,
            attempt: u32::try_from(row.attempt).unwrap_or(u32::MAX),
            progress: row
                .progress_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            error: row
                .error_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            parameter_set_from: row.parameter_set_input_id.clone(),
            parameter_set_id: row.parameter_set_id.clone(),
            network_id: row.network_id.clone(),
            residual_network_from: row.residual_network_input_id.clone(),
            residual_network_id: row.residual_network_id.clone(),
            created_at: rfc3339(row.created_at_ms),
            started_at: row.started_at_ms.map(rfc3339),
            finished_at: row.finished_at_ms.map(rfc3339),
            robot_version: (row.robot_version > 1).then_some(row.robot_version),
            archived_at: row.archived_at_ms.map(rfc3339),
            measurement_set_name: row.measurement_set_name.clone(),
            nominal_rms_mm: row.before_rms_mm,
            rms_mm: row.after_rms_mm,
            finding: row.finding,
        })
    }
}
