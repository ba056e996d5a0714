//! Archiving what is no longer needed, and restoring it. An archived item is left out of lists and is read by its id as before.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::{App, Error, access};
use crate::store::{
    Archivable, JobRow, MeasurementSetRow, NetworkRow, ParameterSetRow, ParameterSetStatus,
    RobotRow, Tx, archive,
};
use crate::wire::job_answer::JobAnswer;
use crate::wire::measurement::SetSummary;
use crate::wire::network::NetworkAnswer;
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::robot::RobotAnswer;
use axum::extract::State;
use axum::response::Response;
use serde::Serialize;

/// A stored item that can be archived.
trait Item: Sized {
    const KIND: Archivable;
    type Answer: Serialize;

    fn id(&self) -> &str;
    fn robot_id(&self) -> &str;
    fn archived_at_ms(&mut self) -> &mut Option<i64>;
    fn answer(self) -> Result<Self::Answer, Error>;

    /// Refuses what must stay in lists.
    fn check(&self) -> Result<(), Error> {
        Ok(())
    }
}

fn refused(detail: String) -> Error {
    Error::Conflict {
        code: "not_archivable",
        detail,
        errors: vec![],
    }
}

async fn put_away<T: Item + Clone>(
    app: &App,
    submission: &Submission,
    item: T,
) -> Result<Response, Error> {
    if let Some(answer) = submission.replay(&app.store).await? {
        return Ok(answer);
    }
    item.check()?;
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        let mut item = item.clone();
        let at_ms = archive::archive(tx, T::KIND, item.id(), item.robot_id(), by).await?;
        *item.archived_at_ms() = Some(at_ms);
        stored_json(200, None, &item.answer()?)
    };
    submission.create(&app.store, effect).await
}

async fn take_back<T: Item + Clone>(
    app: &App,
    submission: &Submission,
    item: T,
) -> Result<Response, Error> {
    if let Some(answer) = submission.replay(&app.store).await? {
        return Ok(answer);
    }
    let effect = async |tx: &mut Tx| {
        let mut item = item.clone();
        archive::restore(tx, T::KIND, item.id(), item.robot_id()).await?;
        *item.archived_at_ms() = None;
        stored_json(200, None, &item.answer()?)
    };
    submission.create(&app.store, effect).await
}

impl Item for RobotRow {
    const KIND: Archivable = Archivable::Robot;
    type Answer = RobotAnswer;

    fn id(&self) -> &str {
        &self.id
    }

    fn robot_id(&self) -> &str {
        &self.id
    }

    fn archived_at_ms(&mut self) -> &mut Option<i64> {
        &mut self.archived_at_ms
    }

    fn answer(self) -> Result<Self::Answer, Error> {
        RobotAnswer::try_from(&self)
    }
}

impl Item for MeasurementSetRow {
    const KIND: Archivable = Archivable::MeasurementSet;
    type Answer = SetSummary;

    fn id(&self) -> &str {
        &self.id
    }

    fn robot_id(&self) -> &str {
        &self.robot_id
    }

    fn archived_at_ms(&mut self) -> &mut Option<i64> {
        &mut self.archived_at_ms
    }

    fn answer(self) -> Result<Self::Answer, Error> {
        SetSummary::try_from(&self)
    }
}

impl Item for JobRow {
    const KIND: Archivable = Archivable::Job;
    type Answer = JobAnswer;

    fn id(&self) -> &str {
        &self.id
    }

    fn robot_id(&self) -> &str {
        &self.robot_id
    }

    fn archived_at_ms(&mut self) -> &mut Option<i64> {
        &mut self.archived_at_ms
    }

    fn answer(self) -> Result<Self::Answer, Error> {
        JobAnswer::try_from(&self)
    }

    fn check(&self) -> Result<(), Error> {
        if self.status.is_over() {
            return Ok(());
        }
        Err(refused(format!(
            "the job is {}: wait until it is over, or cancel it with POST /v1/jobs/{}/cancel",
            self.status.as_str(),
            self.id
        )))
    }
}

impl Item for ParameterSetRow {
    const KIND: Archivable = Archivable::ParameterSet;
    type Answer = ParameterSetAnswer;

    fn id(&self) -> &str {
        &self.id
    }

    fn robot_id(&self) -> &str {
        &self.robot_id
    }

    fn archived_at_ms(&mut self) -> &mut Option<i64> {
        &mut self.archived_at_ms
    }

    fn answer(self) -> Result<Self::Answer, Error> {
        ParameterSetAnswer::try_from(self)
    }

    fn check(&self) -> Result<(), Error> {
        if self.status == ParameterSetStatus::Candidate || self.archived_at_ms.is_some() {
            return Ok(());
        }
        Err(refused(format!(
            "the parameter set is {}; only candidates are archived, because the history of what was released stays",
            self.status.as_str()
        )))
    }
}

impl Item for NetworkRow {
    const KIND: Archivable = Archivable::Network;
    type Answer = NetworkAnswer;

    fn id(&self) -> &str {
        &self.id
    }

    fn robot_id(&self) -> &str {
        &self.robot_id
    }

    fn archived_at_ms(&mut self) -> &mut Option<i64> {
        &mut self.archived_at_ms
    }

    fn answer(self) -> Result<Self::Answer, Error> {
        NetworkAnswer::try_from(self)
    }
}

/// Archives a robot: it is left out of lists and takes no uploads, jobs, edits and releases. Withdrawing and rolling back stay possible.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/archive", tag = "robots", operation_id = "archiveRobot",
    params(("robot_id" = String, Path, description = "The robot")),
    responses((status = 200, description = "The robot", body = RobotAnswer))
)]
pub async fn archive_robot(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::robot(&app, &submission.caller, &id).await?;
    put_away(&app, &submission, item).await
}

/// Restores an archived robot: it is in lists and can be used again.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/restore", tag = "robots", operation_id = "restoreRobot",
    params(("robot_id" = String, Path, description = "The robot")),
    responses((status = 200, description = "The robot", body = RobotAnswer))
)]
pub async fn restore_robot(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::robot(&app, &submission.caller, &id).await?;
    take_back(&app, &submission, item).await
}

/// Archives a measurement set: it is left out of lists, and no new job uses it.
#[utoipa::path(
    post, path = "/v1/measurement-sets/{id}/archive", tag = "measurement sets", operation_id = "archiveMeasurementSet",
    params(("id" = String, Path, description = "The measurement set")),
    responses((status = 200, description = "The measurement set", body = SetSummary))
)]
pub async fn archive_measurement_set(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::measurement_set(&app, &submission.caller, &id).await?;
    put_away(&app, &submission, item).await
}

/// Restores an archived measurement set: it is in lists and can be used again.
#[utoipa::path(
    post, path = "/v1/measurement-sets/{id}/restore", tag = "measurement sets", operation_id = "restoreMeasurementSet",
    params(("id" = String, Path, description = "The measurement set")),
    responses((status = 200, description = "The measurement set", body = SetSummary))
)]
pub async fn restore_measurement_set(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::measurement_set(&app, &submission.caller, &id).await?;
    take_back(&app, &submission, item).await
}

/// Archives a job that has ended: it is left out of lists. What it found stays evidence.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/archive", tag = "jobs", operation_id = "archiveJob",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job", body = JobAnswer))
)]
pub async fn archive_job(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::job(&app, &submission.caller, &id).await?;
    put_away(&app, &submission, item).await
}

/// Restores an archived job: it is in lists and can be used again.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/restore", tag = "jobs", operation_id = "restoreJob",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job", body = JobAnswer))
)]
pub async fn restore_job(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::job(&app, &submission.caller, &id).await?;
    take_back(&app, &submission, item).await
}

/// Archives a candidate: it is left out of lists, is not released and not compared with. What was released is never archived.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/archive", tag = "parameter sets", operation_id = "archiveParameterSet",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "The parameter set", body = ParameterSetAnswer))
)]
pub async fn archive_parameter_set(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::parameter_set(&app, &submission.caller, &id).await?;
    put_away(&app, &submission, item).await
}

/// Restores an archived parameter set: it is in lists and can be used again.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/restore", tag = "parameter sets", operation_id = "restoreParameterSet",
    params(("id" = String, Path, description = "The parameter set")),
    responses((status = 200, description = "The parameter set", body = ParameterSetAnswer))
)]
pub async fn restore_parameter_set(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::parameter_set(&app, &submission.caller, &id).await?;
    take_back(&app, &submission, item).await
}

/// Archives a network: it is left out of lists, and no new job starts from it.
#[utoipa::path(
    post, path = "/v1/networks/{id}/archive", tag = "networks", operation_id = "archiveNetwork",
    params(("id" = String, Path, description = "The network")),
    responses((status = 200, description = "The network", body = NetworkAnswer))
)]
pub async fn archive_network(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::network(&app, &submission.caller, &id).await?;
    put_away(&app, &submission, item).await
}

/// Restores an archived network: it is in lists and can be used again.
#[utoipa::path(
    post, path = "/v1/networks/{id}/restore", tag = "networks", operation_id = "restoreNetwork",
    params(("id" = String, Path, description = "The network")),
    responses((status = 200, description = "The network", body = NetworkAnswer))
)]
pub async fn restore_network(
    State(app): State<App>,
    Id(id): Id,
    submission: Submission,
) -> Result<Response, Error> {
    let item = access::network(&app, &submission.caller, &id).await?;
    take_back(&app, &submission, item).await
}
