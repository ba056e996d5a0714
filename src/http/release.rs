//! Release, withdrawal and rollback of parameter sets.

use crate::http::auth::Caller;
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::limits::{ComputePermit, RequestClass};
use crate::http::{App, Error, access};
use crate::jobs::MeasurementSetInput;
use crate::jobs::evidence::{self, ParsedEvidence};
use crate::release::comparison::PointsToCompare;
use crate::release::{Comparison, Decision, Facts, decide};
use crate::store::{
    AuditEvent, CheckedState, MeasurementSetRow, ParameterSetRow, ParameterSetStatus, PolicyRow,
    Release, RobotRow, Tx,
};
use crate::store::{audit, jobs, measurement_sets, parameter_sets, policies, robots};
use crate::wire::parameter_set::{ParameterSetAnswer, ReasonBody};
use crate::wire::policy::PolicyBody;
use crate::wire::release::{Gate, GatesAnswer, ReleaseBody};
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::{Issue, Problem};
use axum::Json;
use axum::extract::State;
use axum::response::Response;
use std::ops::ControlFlow;
use std::sync::Arc;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of releases.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(gates_now))
        .routes(routes!(release))
        .routes(routes!(withdraw))
        .routes(routes!(roll_back))
}

/// Checks the gates as a release by this key would, and changes nothing.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/gates", tag = "parameter sets", operation_id = "getReleaseGates",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "Every gate, passed or not", body = GatesAnswer))
)]
async fn gates_now(
    State(app): State<App>,
    caller: Caller,
    Id(id): Id,
) -> Result<Json<GatesAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let permit = app.limits.compute(RequestClass::CostlyRead).await?;
    let purpose = Purpose::Release {
        change_reason: None,
    };
    let decision = check_release(&app, &permit, &caller, row, purpose)
        .await?
        .decision;
    Ok(Json(GatesAnswer {
        parameter_set_id: id,
        releasable: decision.is_releasable(),
        evidence: decision.evidence,
        uncertainty_mm: decision.uncertainty_mm,
        gates: decision.gates,
    }))
}

/// Makes a parameter set the robot's active one, if it passes every gate. The one before becomes superseded.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/release", tag = "parameter sets", operation_id = "releaseParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReleaseBody,
    responses((status = 200, description = "The set, released", body = ParameterSetAnswer))
)]
async fn release(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let row = access::parameter_set(&app, &submission.caller, &id).await?;
    if let Some(answer) = submission.replay(&app.store).await? {
        return Ok(answer);
    }
    let body: ReleaseBody = submission.json()?;
    body.check()?;
    let purpose = Purpose::Release {
        change_reason: body.change_reason,
    };
    let permit = app.limits.compute(RequestClass::Write).await?;
    let release = check_release(&app, &permit, &submission.caller, row, purpose)
        .await?
        .release(body.reason)?;
    let effect = async |tx: &mut Tx| {
        stored_json(
            200,
            None,
            &ParameterSetAnswer::try_from(parameter_sets::release(tx, &release).await?)?,
        )
    };
    submission.create(&app.store, effect).await
}

/// Rolls back in one call: the active set is withdrawn, and the one that it superseded is active again.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/parameter-sets/rollback", tag = "parameter sets", operation_id = "rollBackParameterSet",
    params(("robot_id" = String, Path, description = "The robot")), request_body = ReasonBody,
    responses((status = 200, description = "The set that is active now", body = ParameterSetAnswer))
)]
async fn roll_back(
    State(app): State<App>,
    Id(robot_id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    access::robot(&app, &submission.caller, &robot_id).await?;
    let permit = app.limits.safety().await?;
    let reason = match submission.reason(&app.store).await? {
        ControlFlow::Break(answer) => return Ok(answer),
        ControlFlow::Continue(reason) => reason,
    };
    let row = parameter_sets::before_active(&app.store, &robot_id).await?;
    let purpose = Purpose::Rollback;
    let release = check_release(&app, &permit, &submission.caller, row, purpose)
        .await?
        .release(reason)?;
    let effect = async |tx: &mut Tx| {
        stored_json(
            200,
            None,
            &ParameterSetAnswer::try_from(parameter_sets::roll_back(tx, &release).await?)?,
        )
    };
    submission.create(&app.store, effect).await
}

/// Withdraws a parameter set. If it was the active one, the robot has none afterwards.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/withdraw", tag = "parameter sets", operation_id = "withdrawParameterSet",
    params(("id" = String, Path, description = "The parameter set")), request_body = ReasonBody,
    responses((status = 200, description = "The set, withdrawn", body = ParameterSetAnswer))
)]
async fn withdraw(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    access::parameter_set(&app, &submission.caller, &id).await?;
    let _permit = app.limits.safety().await?;
    let reason = match submission.reason(&app.store).await? {
        ControlFlow::Break(answer) => return Ok(answer),
        ControlFlow::Continue(reason) => reason,
    };
    let effect = async |tx: &mut Tx| {
        stored_json(
            200,
            None,
            &ParameterSetAnswer::try_from(
                parameter_sets::withdraw(tx, &id, &reason, &submission.caller.holder).await?,
            )?,
        )
    };
    submission.create(&app.store, effect).await
}

/// Inputs of the gates besides the evidence.
struct GateInputs {
    parameter_set_id: String,
    robot: RobotBody,
    set: MeasurementSetRow,
    /// Keys that uploaded the points of the identification and, if its job used sweeps, the sweeps. `None` for an unknown key.
    uploaders: Vec<Option<String>>,
    policy: PolicyRow,
    status: ParameterSetStatus,
    approver: String,
    purpose: Purpose,
}

/// Purpose of a release check. A superseded set that is released again must pass all gates. For a rollback three gates only warn:
/// `improved_on_active`, `change_plausible` and `orientation_known`.
#[derive(PartialEq, Eq)]
enum Purpose {
    Release { change_reason: Option<String> },
    Rollback,
}

impl Purpose {
    fn change_reason(&self) -> Option<&str> {
        match self {
            Self::Release { change_reason } => change_reason.as_deref(),
            Self::Rollback => None,
        }
    }
}

/// The decision, and everything else that a release writes except its reason.
struct ReleaseCheck {
    id: String,
    checked: CheckedState,
    decision: Decision,
    approver: String,
}

impl ReleaseCheck {
    /// The release to be written, if every gate is passed.
    fn release(self, reason: String) -> Result<Release, Error> {
        if !self.decision.is_releasable() {
            return Err(refused(self.decision.failed().map(Gate::issue).collect()));
        }
        // Counts for the schema's trigger, which refuses a release with a failed gate.
        let n_gates = |passed: bool| {
            let gates = self.decision.gates.iter();
            i64::try_from(gates.filter(|gate| gate.passed == passed).count()).unwrap_or(i64::MAX)
        };
        Ok(Release {
            id: self.id,
            checked: self.checked,
            reason,
            checks_json: serde_json::to_string(&self.decision.gates)?,
            n_passed: n_gates(true),
            n_failed: n_gates(false),
            released_by: self.approver,
            evidence: self.decision.evidence,
            uncertainty_mm: self.decision.uncertainty_mm,
        })
    }
}

/// Reads the evidence of a release and runs the gates on it.
async fn check_release(
    app: &App,
    permit: &ComputePermit,
    caller: &Caller,
    row: ParameterSetRow,
    purpose: Purpose,
) -> Result<ReleaseCheck, Error> {
    let robot = robots::get(&app.store, &row.robot_id).await?;
    let policy = policies::get(&app.store, &row.robot_id).await?;
    let active = parameter_sets::active(&app.store, &row.robot_id).await?;
    let job = jobs::get(&app.store, &row.job_id).await?;
    let set = measurement_sets::get(&app.store, &job.measurement_set_id).await?;
    let mut uploaders = vec![set.uploaded_by.clone()];
    if let Some(frames_id) = &job.frames_id {
        uploaders.push(audit::actor(&app.store, frames_id, AuditEvent::FramesCreated).await?);
    }
    let inputs = GateInputs {
        parameter_set_id: row.id.clone(),
        robot: access::robot_body(&robot)?,
        set,
        uploaders,
        policy: policy.clone(),
        status: row.status,
        approver: caller.holder.clone(),
        purpose,
    };
    let other = active.as_ref().filter(|active| active.id != row.id);
    let stored = evidence::load(&app.store, &row, other).await?;
    let checked = CheckedState {
        active: active.as_ref().map(|active| active.id.clone()),
        policy_version: policy.version,
        n_verifications: stored.n_verifications(),
        robot: robot.check(),
    };
    let parse = move || evidence::parse(stored).map_err(unreadable);
    let parsed = Arc::new(permit.run(parse).await?);
    let comparisons = match inputs.purpose {
        Purpose::Release { .. } => compared(app, permit, &parsed).await?,
        Purpose::Rollback => Vec::new(),
    };
    let run = move || run_gates(&parsed, &comparisons, &inputs, &robot);
    Ok(ReleaseCheck {
        id: row.id,
        checked,
        decision: permit.run(run).await?,
        approver: caller.holder.clone(),
    })
}

/// Compares the set with the active one. Reads one upload or one report at a time.
async fn compared(
    app: &App,
    permit: &ComputePermit,
    parsed: &Arc<ParsedEvidence>,
) -> Result<Vec<Comparison>, Error> {
    let mut comparisons = Vec::new();
    match parsed.points_to_compare() {
        PointsToCompare::Sessions(sessions) => {
            for session in sessions {
                let set_id = &session.measurement_set_id;
                let upload = MeasurementSetInput::read(&app.store, set_id).await?;
                let parsed = Arc::clone(parsed);
                let compare = move || {
                    evidence::compare_on_session(&parsed, &session, &upload).map_err(unreadable)
                };
                comparisons.extend(permit.run(compare).await?);
            }
        }
        PointsToCompare::HeldOut => {
            let report = evidence::held_out_report(&app.store, parsed).await?;
            let parsed = Arc::clone(parsed);
            let compare = move || {
                evidence::compare_on_held_out(&parsed, report.as_deref()).map_err(unreadable)
            };
            comparisons.extend(permit.run(compare).await?);
        }
        PointsToCompare::None => {}
    }
    Ok(comparisons)
}

fn run_gates(
    parsed: &ParsedEvidence,
    comparisons: &[Comparison],
    inputs: &GateInputs,
    robot: &RobotRow,
) -> Result<Decision, Error> {
    Ok(decide(&Facts {
        robot: &Robot::try_from(&inputs.robot)?,
        check_job_id: robot.check_job_id.as_deref(),
        last_check: parsed.last_check.as_ref(),
        checked_seq: robot.checked_seq,
        report: &parsed.report,
        identification: &parsed.identification,
        identification_seq: parsed.identification_seq,
        parameter_set_id: &inputs.parameter_set_id,
        content: &parsed.content,
        active: parsed.active.as_ref(),
        sessions: &parsed.sessions,
        comparisons,
        is_withdrawn: inputs.status == ParameterSetStatus::Withdrawn,
        is_rollback: inputs.purpose == Purpose::Rollback,
        serial_number: inputs.robot.serial_number.as_deref(),
        stated_serial_number: inputs.set.serial_number.as_deref(),
        uploaders: &inputs.uploaders,
        approver: &inputs.approver,
        change_reason: inputs.purpose.change_reason(),
        policy: &PolicyBody::from(&inputs.policy),
    }))
}

fn unreadable(problem: impl AsRef<Problem>) -> Error {
    Error::Internal(problem.as_ref().detail.clone())
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
