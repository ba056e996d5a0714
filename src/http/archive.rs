//! Archives items that are no longer needed, and restores them. An archived item is left out of lists, but can still be read by its id.

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

/// What a request does to an item.
#[derive(Clone, Copy)]
enum Change {
    Archive,
    Restore,
}

/// An item that can be archived.
struct Item<'r> {
    kind: Archivable,
    id: &'r str,
    robot_id: &'r str,
    /// Reason, if the item cannot be archived.
    not_archivable: Option<String>,
}

/// Archives or restores an item. `answer` makes the answer. Its argument is the time at which the item was archived, or `None`.
async fn change_item<A: Serialize>(
    app: &App,
    submission: &Submission,
    change: Change,
    item: Item<'_>,
    answer: impl Fn(Option<i64>) -> Result<A, Error>,
) -> Result<Response, Error> {
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        let archived_at_ms = match (change, item.not_archivable) {
            (Change::Archive, Some(detail)) => {
                return Err(Error::Conflict {
                    code: "not_archivable",
                    detail,
                    errors: vec![],
                });
            }
            (Change::Archive, None) => {
                Some(archive::archive(tx, item.kind, item.id, item.robot_id, by).await?)
            }
            (Change::Restore, _) => {
                archive::restore(tx, item.kind, item.id, item.robot_id).await?;
                None
            }
        };
        stored_json(200, None, &answer(archived_at_ms)?)
    };
    submission.create(&app.store, effect).await
}

async fn robot(
    app: &App,
    id: &str,
    submission: &Submission,
    change: Change,
) -> Result<Response, Error> {
    let row = access::robot(app, &submission.caller, id).await?;
    let item = Item {
        kind: Archivable::Robot,
        id: &row.id,
        robot_id: &row.id,
        not_archivable: None,
    };
    let answer = |archived_at_ms| {
        RobotAnswer::try_from(&RobotRow {
            archived_at_ms,
            ..row.clone()
        })
    };
    change_item(app, submission, change, item, answer).await
}

async fn measurement_set(
    app: &App,
    id: &str,
    submission: &Submission,
    change: Change,
) -> Result<Response, Error> {
    let row = access::measurement_set(app, &submission.caller, id).await?;
    let item = Item {
        kind: Archivable::MeasurementSet,
        id: &row.id,
        robot_id: &row.robot_id,
        not_archivable: None,
    };
    let answer = |archived_at_ms| {
        SetSummary::try_from(&MeasurementSetRow {
            archived_at_ms,
            ..row.clone()
        })
    };
    change_item(app, submission, change, item, answer).await
}

async fn job(
    app: &App,
    id: &str,
    submission: &Submission,
    change: Change,
) -> Result<Response, Error> {
    let row = access::job(app, &submission.caller, id).await?;
    let not_archivable = (!row.status.is_over()).then(|| {
        format!(
            "the job is {}: wait until it is over, or cancel it",
            row.status.as_str()
        )
    });
    let item = Item {
        kind: Archivable::Job,
        id: &row.id,
        robot_id: &row.robot_id,
        not_archivable,
    };
    let answer = |archived_at_ms| {
        JobAnswer::try_from(&JobRow {
            archived_at_ms,
            ..row.clone()
        })
    };
    change_item(app, submission, change, item, answer).await
}

async fn parameter_set(
    app: &App,
    id: &str,
    submission: &Submission,
    change: Change,
) -> Result<Response, Error> {
    let row = access::parameter_set(app, &submission.caller, id).await?;
    let was_released = row.status != ParameterSetStatus::Candidate && row.archived_at_ms.is_none();
    let not_archivable = was_released.then(|| {
        format!(
            "the parameter set is {}; only candidates are archived, because the history of what was released stays",
            row.status.as_str()
        )
    });
    let item = Item {
        kind: Archivable::ParameterSet,
        id: &row.id,
        robot_id: &row.robot_id,
        not_archivable,
    };
    let answer = |archived_at_ms| {
        ParameterSetAnswer::try_from(ParameterSetRow {
            archived_at_ms,
            ..row.clone()
        })
    };
    change_item(app, submission, change, item, answer).await
}

async fn network(
    app: &App,
    id: &str,
    submission: &Submission,
    change: Change,
) -> Result<Response, Error> {
    let row = access::network(app, &submission.caller, id).await?;
    let item = Item {
        kind: Archivable::Network,
        id: &row.id,
        robot_id: &row.robot_id,
        not_archivable: None,
    };
    let answer = |archived_at_ms| {
        NetworkAnswer::try_from(NetworkRow {
            archived_at_ms,
            ..row.clone()
        })
    };
    change_item(app, submission, change, item, answer).await
}

/// Makes the handlers. An entry has the documentation, the name, the function and the change, the path and the name of its id, the tag and the id of
/// the operation, and the description and the shape of the answer.
macro_rules! handlers {
    ($($(#[$doc:meta])+ $name:ident: $kind:ident $change:ident, $path:tt $id:tt, $tag:tt $operation:tt, $what:tt $answer:ident;)+) => {$(
        $(#[$doc])+
        #[utoipa::path(
            post, path = $path, tag = $tag, operation_id = $operation,
            params(($id = String, Path, description = $what)),
            responses((status = 200, description = $what, body = $answer))
        )]
        pub async fn $name(
            State(app): State<App>,
            Id(id): Id,
            submission: Submission,
        ) -> Result<Response, Error> {
            $kind(&app, &id, &submission, Change::$change).await
        }
    )+};
}

handlers! {
    /// Archives a robot: it is left out of lists and takes no uploads, jobs, edits and releases. Withdrawing and rolling back stay possible.
    archive_robot: robot Archive, "/v1/robots/{robot_id}/archive" "robot_id", "robots" "archiveRobot", "The robot" RobotAnswer;
    /// Restores an archived robot: it is in lists and can be used again.
    restore_robot: robot Restore, "/v1/robots/{robot_id}/restore" "robot_id", "robots" "restoreRobot", "The robot" RobotAnswer;
    /// Archives a measurement set: it is left out of lists, and no new job uses it.
    archive_measurement_set: measurement_set Archive, "/v1/measurement-sets/{id}/archive" "id", "measurement sets" "archiveMeasurementSet", "The measurement set" SetSummary;
    /// Restores an archived measurement set: it is in lists and can be used again.
    restore_measurement_set: measurement_set Restore, "/v1/measurement-sets/{id}/restore" "id", "measurement sets" "restoreMeasurementSet", "The measurement set" SetSummary;
    /// Archives a job that has ended: it is left out of lists. Its results stay evidence.
    archive_job: job Archive, "/v1/jobs/{id}/archive" "id", "jobs" "archiveJob", "The job" JobAnswer;
    /// Restores an archived job: it is in lists and can be used again.
    restore_job: job Restore, "/v1/jobs/{id}/restore" "id", "jobs" "restoreJob", "The job" JobAnswer;
    /// Archives a candidate: it is left out of lists, cannot be released, and is not compared with. A set that was released is never archived.
    archive_parameter_set: parameter_set Archive, "/v1/parameter-sets/{id}/archive" "id", "parameter sets" "archiveParameterSet", "The parameter set" ParameterSetAnswer;
    /// Restores an archived parameter set: it is in lists and can be used again.
    restore_parameter_set: parameter_set Restore, "/v1/parameter-sets/{id}/restore" "id", "parameter sets" "restoreParameterSet", "The parameter set" ParameterSetAnswer;
    /// Archives a network: it is left out of lists, and no new job starts from it.
    archive_network: network Archive, "/v1/networks/{id}/archive" "id", "networks" "archiveNetwork", "The network" NetworkAnswer;
    /// Restores an archived network: it is in lists and can be used again.
    restore_network: network Restore, "/v1/networks/{id}/restore" "id", "networks" "restoreNetwork", "The network" NetworkAnswer;
}
