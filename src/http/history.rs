//! A robot's parameters over time, and the comparison of two parameter sets.

use crate::http::extract::{Item, Query};
use crate::http::list_query::PlainListQuery;
use crate::http::{App, Error, access, parameter_sets as parameter_set_answers};
use crate::jobs::JobInputs;
use crate::jobs::estimate::stored_estimate;
use crate::jobs::request::parse_request;
use crate::operations::{self, IdentifiedSet};
use crate::release::{self, ScoredJob, ScoredSession};
use crate::store::{ParameterSetRow, ScoredRelease, parameter_sets, policies, verifications};
use crate::wire::Invalid;
use crate::wire::history::{CompareAnswer, HistoryAnswer, HistoryItem};
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::report_summary::ReportSummary;
use axum::Json;
use serde::Deserialize;
use std::collections::BTreeMap;
use utoipa::IntoParams;

/// Query of a comparison.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CompareQuery {
    /// The other parameter set, of the same robot.
    with: String,
}

/// The robot's identifications, the changes between sessions in units of their uncertainty, and a forecast of the next calibration.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/history", tag = "parameter sets", operation_id = "getHistory",
    params(("robot_id" = String, Path, description = "The robot"), PlainListQuery),
    responses((status = 200, description = "One page, newest first", body = HistoryAnswer))
)]
pub async fn history(
    Item { app, caller, id }: Item,
    Query(query): Query<PlainListQuery>,
) -> Result<Json<HistoryAnswer>, Error> {
    access::robot(&app, &caller, &id).await?;
    let page = parameter_sets::search(&app.store, &id, &query.request()?).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let mut items = Vec::with_capacity(page.items.len());
    for row in page.items {
        let ReportSummary {
            parameters,
            changed,
            verify,
            ..
        } = parameter_set_answers::report_summary(&app, &permit, &row.job_id).await?;
        let answer = ParameterSetAnswer::try_from(&row)?;
        items.push(HistoryItem {
            parameter_set_id: answer.id,
            created_at: answer.created_at,
            status: answer.status,
            parameters,
            verify_rms_mm: verify.map(|verify| verify.corrected.unwrap_or(verify.after).rms_mm),
            changed: changed.unwrap_or_default(),
            job_archived_at: answer.job_archived_at,
        });
    }
    let limit_mm = policies::get(&app.store, &id).await?.tolerance_mm;
    let scored = scored_sessions(&app, &[&id]).await?.remove(&id);
    let trend = release::trend(&scored.unwrap_or_default(), limit_mm);
    Ok(Json(HistoryAnswer {
        items,
        next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
        total: page.total,
        trend,
    }))
}

/// The errors of the released set of each of these robots over the jobs that scored it. A robot without a released set is absent.
pub(super) async fn scored_sessions(
    app: &App,
    robot_ids: &[&str],
) -> Result<BTreeMap<String, Vec<ScoredSession>>, Error> {
    let mut rows_of: BTreeMap<String, Vec<ScoredRelease>> = BTreeMap::new();
    for row in verifications::of_released_sets(&app.store, robot_ids).await? {
        let robot = row.facts.robot_id.clone();
        rows_of.entry(robot).or_default().push(row);
    }
    let scored = rows_of
        .into_iter()
        .map(|(robot, rows)| (robot, sessions_of(rows)));
    Ok(scored.collect())
}

/// The sessions of one released set. With several uploads of a job, the latest time counts.
fn sessions_of(rows: Vec<ScoredRelease>) -> Vec<ScoredSession> {
    let own = rows.iter().filter(|row| row.is_own_upload);
    let own_uploads: Vec<String> = own
        .map(|row| row.facts.measurement_set_id.clone())
        .collect();
    let mut jobs: Vec<(String, ScoredJob)> = Vec::new();
    for row in rows {
        let at_ms = release::measured_at_ms(row.reading_json.as_deref(), row.uploaded_at_ms);
        match jobs.last_mut() {
            Some((job_id, job)) if *job_id == row.facts.job_id => {
                job.measured_at_ms = job.measured_at_ms.max(at_ms);
            }
            _ => jobs.push((
                row.facts.job_id,
                ScoredJob {
                    measured_at_ms: at_ms,
                    measurement_set_id: row.facts.measurement_set_id,
                    verification: row.facts.found,
                },
            )),
        }
    }
    let jobs: Vec<ScoredJob> = jobs.into_iter().map(|(_, job)| job).collect();
    release::scored_sessions(&jobs, &own_uploads)
}

/// Time of measurement for each job that scored a parameter set, milliseconds since the epoch: the stated time, or the time of upload. With
/// several sessions, the latest time counts.
pub(super) async fn session_times(
    app: &App,
    parameter_set_id: &str,
) -> Result<BTreeMap<String, i64>, Error> {
    let mut times = BTreeMap::new();
    for upload in verifications::scored_uploads(&app.store, parameter_set_id).await? {
        let reading_json = upload.reading_json.as_deref();
        let at_ms = release::measured_at_ms(reading_json, upload.uploaded_at_ms);
        let last = times.entry(upload.job_id).or_insert(at_ms);
        *last = at_ms.max(*last);
    }
    Ok(times)
}

/// Differences between two parameter sets of a robot: the tool over the workspace, and a test of their sessions.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/compare", tag = "parameter sets", operation_id = "compareParameterSets",
    params(("id" = String, Path, description = "The parameter set"), CompareQuery),
    responses((status = 200, description = "The differences", body = CompareAnswer))
)]
pub async fn compare(
    Item { app, caller, id }: Item,
    Query(query): Query<CompareQuery>,
) -> Result<Json<CompareAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let other = match access::parameter_set(&app, &caller, &query.with).await {
        Ok(other) if other.robot_id == row.robot_id => other,
        Ok(_) | Err(Error::NotFound(_)) => {
            return Err(Invalid::at(
                "/with",
                "unknown_reference",
                "this robot has no parameter set with this id",
            )
            .into());
        }
        Err(error) => return Err(error),
    };
    let permit = app.limits.compute_permit(caller.class).await?;
    let inputs = (
        JobInputs::load(&app.store, &row.job_id).await?,
        JobInputs::load(&app.store, &other.job_id).await?,
    );
    let estimates = (
        parameter_sets::estimate(&app.store, &row.id).await?,
        parameter_sets::estimate(&app.store, &other.id).await?,
    );
    let compare = move || {
        let own = identified(&row, &inputs.0, estimates.0.as_deref())?;
        let with = identified(&other, &inputs.1, estimates.1.as_deref())?;
        Ok::<_, Error>(operations::compare(own, with)?)
    };
    Ok(Json(permit.run(compare).await?))
}

fn identified(
    row: &ParameterSetRow,
    inputs: &JobInputs,
    estimate_json: Option<&str>,
) -> Result<IdentifiedSet, Error> {
    let unreadable = || Error::Internal("the inputs of a comparison cannot be read".into());
    let request = parse_request(inputs).map_err(|_| unreadable())?;
    let estimate = stored_estimate(estimate_json, &inputs.robot, Some(request.model()));
    Ok(IdentifiedSet {
        id: row.id.clone(),
        content: parameter_set_answers::content(row)?,
        request,
        uploads_sha256: inputs
            .sets
            .iter()
            .map(|upload| upload.row.sha256.clone())
            .collect(),
        estimate: estimate.map_err(|_| unreadable())?,
    })
}
