//! Release, withdrawal and rollback of parameter sets.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Item};
use crate::http::{Error, access};
use crate::jobs::release_check::{Purpose, ReleaseCheckError, ReleaseRequest, check};
use crate::store::{Tx, parameter_sets};
use crate::wire::Issue;
use crate::wire::parameter_set::{ParameterSetAnswer, ReasonBody};
use crate::wire::release::{GatesAnswer, ReleaseBody};
use axum::Json;
use axum::response::Response;

/// Checks all gates as for a release by this key. Changes nothing.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/gates", tag = "parameter sets", operation_id = "getReleaseGates",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "Every gate, passed or not", body = GatesAnswer))
)]
pub async fn gates(Item { app, caller, id }: Item) -> Result<Json<GatesAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let request = ReleaseRequest {
        set: row,
        approver: caller.holder,
        purpose: Purpose::Release {
            change_reason: None,
        },
    };
    let decision = check(&app.store, &permit, request).await?.decision;
    Ok(Json(GatesAnswer {
        parameter_set_id: id,
        releasable: decision.is_releasable(),
        evidence: decision.evidence,
        uncertainty_mm: decision.uncertainty_mm,
        gates: decision.gates,
    }))
}

/// Makes a parameter set the robot's active one, if it passes every gate. The previous active set becomes superseded.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/release", tag = "parameter sets", operation_id = "releaseParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReleaseBody,
    responses((status = 200, description = "The set, released", body = ParameterSetAnswer))
)]
pub async fn release(Id(id): Id, submission: Submission) -> Result<Response, Error> {
    let app = &submission.app;
    let row = access::parameter_set(app, &submission.caller, &id).await?;
    let body: ReleaseBody = submission.json()?;
    body.check()?;
    let request = ReleaseRequest {
        set: row,
        approver: submission.caller.holder.clone(),
        purpose: Purpose::Release {
            change_reason: body.change_reason,
        },
    };
    let permit = app.limits.compute_permit(submission.caller.class).await?;
    let released = async {
        let checked = check(&app.store, &permit, request).await?;
        let release = checked.release(body.reason)?;
        let effect = async |tx: &mut Tx| {
            let row = parameter_sets::release(tx, &release).await?;
            stored_json(200, None, &ParameterSetAnswer::try_from(&row)?)
        };
        submission.create(effect).await
    };
    submission.or_replay(released.await).await
}

/// Rolls back in one call: the active set is withdrawn, and the set that it superseded becomes active again.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/parameter-sets/rollback", tag = "parameter sets", operation_id = "rollBackParameterSet",
    params(("robot_id" = String, Path, description = "The robot")), request_body = ReasonBody,
    responses((status = 200, description = "The set that is active now", body = ParameterSetAnswer))
)]
pub async fn roll_back(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    let app = &submission.app;
    access::robot(app, &submission.caller, &robot_id).await?;
    let permit = app.limits.compute_permit(submission.caller.class).await?;
    let reason = submission.reason()?;
    let rolled_back = async {
        let request = ReleaseRequest {
            set: parameter_sets::before_active(&app.store, &robot_id).await?,
            approver: submission.caller.holder.clone(),
            purpose: Purpose::Rollback,
        };
        let checked = check(&app.store, &permit, request).await?;
        let release = checked.release(reason)?;
        let effect = async |tx: &mut Tx| {
            let row = parameter_sets::roll_back(tx, &release).await?;
            stored_json(200, None, &ParameterSetAnswer::try_from(&row)?)
        };
        submission.create(effect).await
    };
    submission.or_replay(rolled_back.await).await
}

/// Withdraws a parameter set. If it was the active one, the robot has none afterwards.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/withdraw", tag = "parameter sets", operation_id = "withdrawParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReasonBody,
    responses((status = 200, description = "The set, withdrawn", body = ParameterSetAnswer))
)]
pub async fn withdraw(Id(id): Id, submission: Submission) -> Result<Response, Error> {
    let app = &submission.app;
    access::parameter_set(app, &submission.caller, &id).await?;
    let _permit = app.limits.compute_permit(submission.caller.class).await?;
    let reason = submission.reason()?;
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        let row = parameter_sets::withdraw(tx, &id, &reason, by).await?;
        stored_json(200, None, &ParameterSetAnswer::try_from(&row)?)
    };
    submission.create(effect).await
}

impl From<ReleaseCheckError> for Error {
    fn from(error: ReleaseCheckError) -> Self {
        match error {
            ReleaseCheckError::Store(error) => error.into(),
            ReleaseCheckError::Refused(issues) => refused(issues),
            ReleaseCheckError::Unreadable(_) | ReleaseCheckError::Stopped(_) => {
                Self::Internal(error.to_string())
            }
        }
    }
}

fn refused(errors: Vec<Issue>) -> Error {
    let names: Vec<&str> = errors.iter().map(|issue| issue.code.as_str()).collect();
    Error::Conflict {
        code: "release_refused",
        detail: format!(
            "this set may not move a robot; gates that failed: {}",
            names.join(", ")
        ),
        errors,
    }
}
