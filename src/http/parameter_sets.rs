//! Parameter sets: the identified parameters for the controller.

use crate::calibration::request::Estimate;
use crate::http::extract::Item;
use crate::http::headers::matches_etag;
use crate::http::limits::ComputePermit;
use crate::http::list_query::{ParameterSetListQuery, list_of_robot};
use crate::http::{App, Error, access};
use crate::jobs::estimate::estimate_of;
use crate::release;
use crate::store::{
    ParameterSetRow, ParameterSetStatus, jobs, measurement_sets, parameter_sets, report_summaries,
    robots,
};
use crate::wire::canonical;
use crate::wire::measurement::Warning;
use crate::wire::page::Page;
use crate::wire::parameter_set::{ParameterSetAnswer, ParameterSetContent, Provenance};
use crate::wire::report_summary::ReportSummary;
use crate::wire::robot::RobotBody;
use crate::wire::time::rfc3339;
use axum::Json;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

list_of_robot! {
    /// A robot's parameter sets.
    list: "/v1/robots/{robot_id}/parameter-sets" "parameter sets" "listParameterSets", ParameterSetListQuery ParameterSetAnswer, parameter_sets::search
}

/// One parameter set.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}", tag = "parameter sets", operation_id = "getParameterSet",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "The parameter set", body = ParameterSetAnswer))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<ParameterSetAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    Ok(Json((&row).try_into()?))
}

/// The robot's released parameter set. Send its `ETag` as `If-None-Match` to get 304 while it has not changed.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/parameter-sets/active", tag = "parameter sets", operation_id = "getActiveParameterSet",
    params(("robot_id" = String, Path, description = "The robot"), ("If-None-Match" = Option<String>, Header, description = "An ETag known already")),
    responses(
        (status = 200, description = "The released set", body = ParameterSetAnswer, headers(("ETag" = String, description = "Changes with the set"))),
        (status = 304, description = "Still the set of that ETag")
    )
)]
pub async fn active(Item { app, caller, id }: Item, headers: HeaderMap) -> Result<Response, Error> {
    access::robot(&app, &caller, &id).await?;
    let row = parameter_sets::active(&app.store, &id)
        .await?
        .ok_or(Error::NoActiveParameterSet)?;
    let body = serde_json::to_vec(&ParameterSetAnswer::try_from(&row)?)?;
    let etag = format!("\"{}\"", canonical::sha256_hex(&body));
    if matches_etag(&headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, etag)]).into_response());
    }
    let headers = [
        (header::CONTENT_TYPE, "application/json".to_owned()),
        (header::ETAG, etag),
    ];
    Ok((headers, body).into_response())
}

/// The identified parameters, as exactly the bytes whose SHA-256 is the set's `sha256`.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/content", tag = "parameter sets", operation_id = "getParameterSetContent",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "Canonical JSON (RFC 8785)", body = ParameterSetContent))
)]
pub async fn get_content(Item { app, caller, id }: Item) -> Result<Response, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let content = content(&row)?;
    let text = match canonical::text_with_hash(&content, &row.sha256)? {
        Some(text) => text,
        // The row was edited outside the service. The client will find that the hash differs.
        None => canonical::to_canonical_json(&content)?,
    };
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

/// The identified parameters.
pub fn content(row: &ParameterSetRow) -> Result<ParameterSetContent, Error> {
    Ok(serde_json::from_str(&row.body_json)?)
}

/// The provenance of a parameter set, with the warnings of its report that its users should see.
pub async fn provenance(
    app: &App,
    permit: &ComputePermit,
    row: &ParameterSetRow,
) -> Result<Provenance, Error> {
    let summary = report_summary(app, permit, &row.job_id).await?;
    let job = jobs::get(&app.store, &row.job_id).await?;
    let measured = measurement_sets::get(&app.store, &job.measurement_set_id).await?;
    Ok(release::provenance(summary, Some(measured.frame)))
}

/// Warnings for everybody who corrects or predicts with a parameter set: it was withdrawn, or its robot is in the state `check_robot`.
pub async fn warnings_of_use(app: &App, row: &ParameterSetRow) -> Result<Vec<Warning>, Error> {
    let mut warnings = Vec::new();
    if row.status == ParameterSetStatus::Withdrawn {
        let reason = row.withdraw_reason.as_deref().unwrap_or_default();
        let detail = format!(
            "the parameter set was withdrawn ({reason}): do not move a robot with it, use the active set"
        );
        warnings.push(Warning::new("set_withdrawn", detail));
    }
    let robot = robots::get(&app.store, &row.robot_id).await?;
    if let Some(job_id) = robot.check_job_id {
        let detail = format!(
            "the session of job {job_id} speaks against this robot. It may have changed since this set was identified: look \
             at the robot before it moves by these numbers"
        );
        warnings.push(Warning::new("check_robot", detail));
    }
    Ok(warnings)
}

/// The estimate that is stored with a parameter set. `None` if there is none, because the uncertainty is not known. `None` also if a target of the
/// set moved, because the estimate then has several targets for it.
pub async fn estimate(
    app: &App,
    permit: &ComputePermit,
    row: &ParameterSetRow,
    robot: &RobotBody,
) -> Result<Option<Estimate>, Error> {
    let Some(text) = parameter_sets::estimate(&app.store, &row.id).await? else {
        return Ok(None);
    };
    let (content, robot) = (content(row)?, robot.clone());
    let read = move || {
        let found = estimate_of(Some(&text), &robot)
            .map_err(|_| Error::Internal("a stored estimate cannot be read".into()))?;
        let is_one_each = content
            .targets
            .iter()
            .all(|target| target.segment.is_none());
        Ok::<_, Error>(found.map(|(_, estimate)| estimate).filter(|_| is_one_each))
    };
    permit.run(read).await
}

/// The summary of a job's report.
pub async fn report_summary(
    app: &App,
    permit: &ComputePermit,
    job_id: &str,
) -> Result<ReportSummary, Error> {
    let summary = report_summaries::of_job(&app.store, job_id).await?;
    permit.run(move || serde_json::from_str(&summary)).await
}

impl TryFrom<&ParameterSetRow> for ParameterSetAnswer {
    type Error = Error;

    fn try_from(row: &ParameterSetRow) -> Result<Self, Error> {
        let ParameterSetContent {
            links,
            t_instrument_base,
            targets,
            links_with_corrections,
            corrections,
        } = content(row)?;
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            job_id: row.job_id.clone(),
            status: row.status,
            links,
            t_instrument_base,
            targets,
            links_with_corrections,
            corrections,
            sha256: row.sha256.clone(),
            created_at: rfc3339(row.created_at_ms),
            released_at: row.released_at_ms.map(rfc3339),
            release_reason: row.release_reason.clone(),
            released_by: row.released_by.clone(),
            released_by_name: row.released_by_name.clone(),
            withdrawn_at: row.withdrawn_at_ms.map(rfc3339),
            withdraw_reason: row.withdraw_reason.clone(),
            withdrawn_by: row.withdrawn_by.clone(),
            withdrawn_by_name: row.withdrawn_by_name.clone(),
            release_checks: row
                .release_checks_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            archived_at: row.archived_at_ms.map(rfc3339),
            job_archived_at: row.job_archived_at_ms.map(rfc3339),
        })
    }
}
