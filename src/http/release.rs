//! Releasing and withdrawing parameter sets.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::{App, Error, access, parameter_sets as answers};
use crate::store::{ParameterSetRow, ParameterSetStatus, Release, Tx, jobs, parameter_sets};
use crate::wire::Issue;
use crate::wire::parameter_set::{ParameterSetAnswer, ReasonBody};
use crate::wire::release::{Gate, gates};
use crate::wire::report_shape::Report;
use axum::extract::State;
use axum::response::Response;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of releases.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(release)).routes(routes!(withdraw))
}

/// Makes a parameter set the robot's active one, if it passes every gate. The one before becomes superseded.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/release", tag = "parameter sets", operation_id = "releaseParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReasonBody,
    responses((status = 200, description = "The set, released", body = ParameterSetAnswer))
)]
async fn release(State(app): State<App>, Id(id): Id, submission: Submission) -> Result<Response, Error> {
    let row = access::parameter_set(&app, &submission.caller, &id).await?;
    if let Some(answer) = submission.replay(&app.store).await? {
        return Ok(answer);
    }
    let ReasonBody { reason } = reason(&submission)?;
    let checks = pass(&app, &row).await?;
    let active = parameter_sets::active(&app.store, &row.robot_id).await?;
    let release = Release {
        id,
        active_when_checked: active.map(|active| active.id),
        reason,
        checks_json: serde_json::to_string(&checks)?,
        released_by: submission.caller.holder.clone(),
    };
    let effect = async |tx: &mut Tx| stored_json(200, None, &answers::answer(parameter_sets::release(tx, &release).await?)?);
    submission.create(&app.store, effect).await
}

/// Takes a parameter set back. If it was the active one, the robot has none afterwards.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/withdraw", tag = "parameter sets", operation_id = "withdrawParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReasonBody,
    responses((status = 200, description = "The set, withdrawn", body = ParameterSetAnswer))
)]
async fn withdraw(State(app): State<App>, Id(id): Id, submission: Submission) -> Result<Response, Error> {
    access::parameter_set(&app, &submission.caller, &id).await?;
    if let Some(answer) = submission.replay(&app.store).await? {
        return Ok(answer);
    }
    let ReasonBody { reason } = reason(&submission)?;
    let effect = async |tx: &mut Tx| {
        stored_json(200, None, &answers::answer(parameter_sets::withdraw(tx, &id, &reason, &submission.caller.holder).await?)?)
    };
    submission.create(&app.store, effect).await
}

fn reason(submission: &Submission) -> Result<ReasonBody, Error> {
    let body: ReasonBody = submission.json()?;
    body.check()?;
    Ok(body)
}

/// Every gate's outcome if all passed. A set that was released before has passed them.
async fn pass(app: &App, row: &ParameterSetRow) -> Result<Vec<Gate>, Error> {
    if row.status == ParameterSetStatus::Withdrawn {
        return Err(refused(vec![Issue { code: "withdrawn".into(), detail: "the set was withdrawn".into(), ..Issue::default() }]));
    }
    let report: Report = serde_json::from_str(&jobs::report(&app.store, &row.job_id).await?)?;
    let gates = gates(&report, &answers::content(row)?);
    let failed: Vec<Issue> = gates.iter().filter(|gate| !gate.passed).map(Gate::issue).collect();
    if failed.is_empty() { Ok(gates) } else { Err(refused(failed)) }
}

fn refused(errors: Vec<Issue>) -> Error {
    let names: Vec<&str> = errors.iter().map(|issue| issue.code.as_str()).collect();
    Error::Conflict {
        code: "release_refused",
        detail: format!("this set may not move a robot; gates that failed: {}", names.join(", ")),
        errors,
    }
}
