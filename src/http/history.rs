//! How a robot's parameters went over time, and what two parameter sets say differently.

use crate::calibration::changes::changes;
use crate::calibration::request::PreviousSession;
use crate::http::auth::Caller;
use crate::http::extract::{Id, ListQuery, Query};
use crate::http::turns::Turn;
use crate::http::{App, Error, access, parameter_sets as answers};
use crate::jobs::JobInputs;
use crate::jobs::execution::request_of;
use crate::store::{
    JobRow, JobStatus, MAX_PAGE_SIZE, PageRequest, ParameterSetRow, jobs, parameter_sets, policies,
};
use crate::wire::Invalid;
use crate::wire::history::{
    CompareAnswer, HistoryAnswer, HistoryItem, ReportExcerpt, SessionTest, map,
};
use crate::wire::trend::{Scored, Trend};
use axum::Json;
use axum::extract::State;
use serde::Deserialize;
use std::ops::ControlFlow;
use utoipa::IntoParams;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Most sessions that a trend is drawn through: the newest.
const MAX_SESSIONS: usize = 200;
/// Most pages of jobs that are looked through for them.
const MAX_JOB_PAGES: usize = 50;
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

/// What was identified when, what moved since the session before in units of its own uncertainty, and when to calibrate next.
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
    let turn = app.turn().await?;
    let mut items = Vec::with_capacity(page.items.len());
    for row in page.items {
        let report = excerpt(&app, &turn, &row.job_id).await?;
        let verify_rms_mm = report.verify_rms_mm();
        let ReportExcerpt {
            parameters,
            changed,
            ..
        } = report;
        let answer = answers::answer(row)?;
        items.push(HistoryItem {
            parameter_set_id: answer.id,
            created_at: answer.created_at,
            status: answer.status,
            parameters,
            verify_rms_mm,
            changed: changed.unwrap_or_default(),
        });
    }
    let trend = trend(&app, &turn, &robot_id).await?;
    Ok(Json(HistoryAnswer {
        items,
        next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
        trend,
    }))
}

/// What of a job's report the history shows. A report of 20,000 points has 9 MB, so no more than one is in memory for each request.
async fn excerpt(app: &App, turn: &Turn, job_id: &str) -> Result<ReportExcerpt, Error> {
    let report = jobs::report(&app.store, job_id).await?;
    Ok(turn.run(|| serde_json::from_str(&report))?)
}

/// The trend of the released set's errors: of its own held-out points, and of the sessions that it was scored on.
async fn trend(app: &App, turn: &Turn, robot_id: &str) -> Result<Trend, Error> {
    let limit_mm = policies::get(&app.store, robot_id).await?.tolerance_mm;
    let Some(active) = parameter_sets::active(&app.store, robot_id).await? else {
        return Ok(Trend::of(&[], limit_mm));
    };
    let mut all = sessions(app, &active).await?;
    all.push((active.created_at_ms, active.job_id));
    let mut scored = Vec::new();
    for (at_ms, job_id) in all {
        let report = excerpt(app, turn, &job_id).await?;
        scored.extend(report.verify_rms_mm().map(|rms_mm| Scored {
            day: at_ms as f64 / DAY_MS,
            rms_mm,
        }));
    }
    Ok(Trend::of(&scored, limit_mm))
}

/// When and by which jobs a parameter set was scored on sets other than its own, newest first; of each set the first time, which is nearest to
/// when it was measured. Found among the robot's jobs, which come without their reports.
async fn sessions(app: &App, active: &ParameterSetRow) -> Result<Vec<(i64, String)>, Error> {
    let is_session = |job: &JobRow| {
        job.kind == "verify"
            && job.status == JobStatus::Succeeded
            && job.parameter_set_input_id.as_deref() == Some(active.id.as_str())
    };
    let own = jobs::get(&app.store, &active.job_id).await?;
    let own = [Some(own.measurement_set_id), own.verify_set_id];
    let (mut found, mut cursor): (Vec<JobRow>, _) = (Vec::new(), None);
    for _ in 0..MAX_JOB_PAGES {
        let page = jobs::list(
            &app.store,
            &active.robot_id,
            &PageRequest {
                limit: MAX_PAGE_SIZE,
                cursor,
            },
        )
        .await?;
        // Nothing was scored before it was there.
        let is_older = page
            .items
            .last()
            .is_none_or(|job| job.created_at_ms < active.created_at_ms);
        for job in page
            .items
            .into_iter()
            .filter(is_session)
            .filter(|job| !own.contains(&Some(job.measurement_set_id.clone())))
        {
            found.retain(|newer| newer.measurement_set_id != job.measurement_set_id);
            found.push(job);
        }
        cursor = page.next_cursor;
        if is_older || cursor.is_none() || found.len() >= MAX_SESSIONS {
            break;
        }
    }
    found.truncate(MAX_SESSIONS);
    Ok(found
        .into_iter()
        .map(|job| (job.created_at_ms, job.id))
        .collect())
}

/// What two parameter sets of a robot say differently: the tool over the workspace, and a test of the sessions behind them.
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
    let turn = app.turn().await?;
    let inputs = (
        JobInputs::load(&app.store, &row.job_id).await?,
        JobInputs::load(&app.store, &other.job_id).await?,
    );
    Ok(Json(
        turn.run(|| compared(&row, &other, &inputs.0, &inputs.1))?,
    ))
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
    let (map, mean_mm, max_mm) = map(
        &request.robot,
        &answers::content(row)?,
        &answers::content(other)?,
    );
    let same_upload = own.set.row.sha256 == others.set.row.sha256;
    request.previous = (!same_upload).then_some(PreviousSession {
        set: other_request.set,
        frames: other_request.frames,
    });
    let changes = changes(&request, &mut |_| ControlFlow::Continue(()))?;
    Ok(CompareAnswer {
        parameter_set_id: row.id.clone(),
        with: other.id.clone(),
        mean_mm,
        max_mm,
        map,
        sessions: changes.as_ref().map(SessionTest::from_core),
    })
}
