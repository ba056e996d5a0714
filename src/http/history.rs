//! A robot's parameters over time, and the comparison of two parameter sets.

use crate::calibration::changes::changes;
use crate::calibration::request::PreviousSession;
use crate::calibration::tool_differences;
use crate::http::auth::Caller;
use crate::http::extract::{Id, ListQuery, Query};
use crate::http::limits::ComputePermit;
use crate::http::request_class::RequestClass;
use crate::http::{App, Error, access, parameter_sets as answers};
use crate::jobs::JobInputs;
use crate::jobs::execution::request_of;
use crate::release::{self, ScoredSession};
use crate::store::{ParameterSetRow, jobs, parameter_sets, policies, verifications};
use crate::wire::Invalid;
use crate::wire::history::{
    CompareAnswer, HistoryAnswer, HistoryItem, MapPoint, ReportExcerpt, SessionTest,
};
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::trend::Trend;
use crate::wire::verification::Fit;
use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use utoipa::IntoParams;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Most sessions in a trend; older ones are left out.
const MAX_SESSIONS: usize = 200;
/// Milliseconds of a day.
const DAY_MS: f64 = 86_400_000.0;

/// Routes of history and comparison.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(history))
        .routes(routes!(compare))
}

/// Query of a comparison.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct CompareQuery {
    /// The other parameter set, of the same robot.
    with: String,
}

/// The robot's identifications, the changes between sessions in units of their own uncertainty, and when to calibrate next.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/history", tag = "parameter sets", operation_id = "getHistory",
    params(("robot_id" = String, Path, description = "The robot"), ListQuery),
    responses((status = 200, description = "One page, newest first", body = HistoryAnswer))
)]
async fn history(
    State(app): State<App>,
    caller: Caller,
    Id(robot_id): Id,
    Query(query): Query<ListQuery>,
) -> Result<Json<HistoryAnswer>, Error> {
    access::robot(&app, &caller, &robot_id).await?;
    let page = parameter_sets::list(&app.store, &robot_id, &query.page()?).await?;
    let permit = app.compute_permit(RequestClass::CostlyRead).await?;
    let mut items = Vec::with_capacity(page.items.len());
    for row in page.items {
        let report = excerpt(&app, &permit, &row.job_id).await?;
        let verify_rms_mm = report.verify_rms_mm();
        let ReportExcerpt {
            parameters,
            changed,
            ..
        } = report;
        let answer = ParameterSetAnswer::try_from(row)?;
        items.push(HistoryItem {
            parameter_set_id: answer.id,
            created_at: answer.created_at,
            status: answer.status,
            parameters,
            verify_rms_mm,
            changed: changed.unwrap_or_default(),
        });
    }
    let trend = trend(&app, &robot_id).await?;
    Ok(Json(HistoryAnswer {
        items,
        next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
        trend,
    }))
}

/// Reads the parts of a report that the history shows. Call it for one report at a time: a report of 20,000 points has 9 MB.
async fn excerpt(app: &App, permit: &ComputePermit, job_id: &str) -> Result<ReportExcerpt, Error> {
    let report = jobs::report(&app.store, job_id).await?;
    permit.run(move || serde_json::from_str(&report)).await
}

/// The trend of the released set's errors on its own held-out points and on later sessions. Each upload counts once, with its first score,
/// which is nearest to the time of measurement.
async fn trend(app: &App, robot_id: &str) -> Result<Trend, Error> {
    let limit_mm = policies::get(&app.store, robot_id).await?.tolerance_mm;
    let Some(active) = parameter_sets::active(&app.store, robot_id).await? else {
        return Ok(release::trend(&[], limit_mm));
    };
    let own = jobs::get(&app.store, &active.job_id).await?;
    let mut uploads = BTreeSet::from([Some(own.measurement_set_id), own.verify_set_id]);
    let mut scored = Vec::new();
    for row in verifications::of_set(&app.store, &active.id).await? {
        let is_session = row.is_session();
        if is_session && !uploads.insert(Some(row.measurement_set_id)) {
            continue;
        }
        let fits = row.fit != Fit::DoesNotFit && row.n_points > 0;
        scored.extend(
            row.after_rms_mm
                .filter(|_| fits)
                .map(|rms_mm| ScoredSession {
                    day: row.created_at_ms as f64 / DAY_MS,
                    rms_mm,
                }),
        );
    }
    let newest = scored.len().saturating_sub(MAX_SESSIONS);
    Ok(release::trend(&scored[newest..], limit_mm))
}

/// Differences between two parameter sets of a robot: the tool over the workspace, and a test of their sessions.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/compare", tag = "parameter sets", operation_id = "compareParameterSets",
    params(("id" = String, Path, description = "The parameter set"), CompareQuery),
    responses((status = 200, description = "The differences", body = CompareAnswer))
)]
async fn compare(
    State(app): State<App>,
    caller: Caller,
    Id(id): Id,
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
    let permit = app.compute_permit(RequestClass::CostlyRead).await?;
    let inputs = (
        JobInputs::load(&app.store, &row.job_id).await?,
        JobInputs::load(&app.store, &other.job_id).await?,
    );
    let compare = move || compared(&row, &other, &inputs.0, &inputs.1);
    Ok(Json(permit.run(compare).await?))
}

fn compared(
    row: &ParameterSetRow,
    other: &ParameterSetRow,
    own: &JobInputs,
    others: &JobInputs,
) -> Result<CompareAnswer, Error> {
    let unreadable = |_| Error::Internal("what a comparison rests on cannot be read".into());
    let (mut request, other_request) = (
        request_of(own).map_err(unreadable)?,
        request_of(others).map_err(unreadable)?,
    );
    let differences = tool_differences(
        &request.robot,
        &answers::content(row)?.identified_robot(None),
        &answers::content(other)?.identified_robot(None),
    );
    let same_upload = own.set.row.sha256 == others.set.row.sha256;
    request.previous = (!same_upload).then_some(PreviousSession {
        set: other_request.set,
        frames: other_request.frames,
    });
    let changes = changes(&request, None, &mut |_| ControlFlow::Continue(()))?;
    Ok(CompareAnswer {
        parameter_set_id: row.id.clone(),
        with: other.id.clone(),
        mean_mm: differences.mean_mm,
        max_mm: differences.max_mm,
        map: differences.points.iter().map(MapPoint::from).collect(),
        sessions: changes.as_ref().map(SessionTest::from),
    })
}
