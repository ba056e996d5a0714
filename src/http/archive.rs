//! Archives items that are no longer needed, and restores them. An archived item is left out of lists, but can still be read by its id.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::{Error, access};
use crate::store::{Archivable, JobRow, ParameterSetRow, ParameterSetStatus, Tx, archive};
use crate::wire::job_answer::JobAnswer;
use crate::wire::measurement::SetSummary;
use crate::wire::network::NetworkAnswer;
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::robot::RobotAnswer;
use axum::response::Response;

/// What a request does to an item.
#[derive(Clone, Copy)]
enum Change {
    Archive,
    Restore,
}

/// Archives or restores an item. Returns the time of archiving; `None` after a restore.
async fn apply(
    tx: &mut Tx,
    change: Change,
    kind: Archivable,
    id: &str,
    robot_id: &str,
    by: &str,
) -> Result<Option<i64>, Error> {
    Ok(match change {
        Change::Archive => Some(archive::archive(tx, kind, id, robot_id, by).await?),
        Change::Restore => {
            archive::restore(tx, kind, id, robot_id).await?;
            None
        }
    })
}

/// The reason why this job cannot be archived yet; `None` if it can.
fn still_runs(row: &JobRow) -> Option<String> {
    let status = row.status.as_str();
    (!row.status.is_over())
        .then(|| format!("the job is {status}: wait until it is over, or cancel it"))
}

/// The reason why this parameter set cannot be archived; `None` if it can.
fn was_released(row: &ParameterSetRow) -> Option<String> {
    let status = row.status.as_str();
    let was_released = row.status != ParameterSetStatus::Candidate && row.archived_at_ms.is_none();
    was_released.then(|| {
        format!(
            "the parameter set is {status}; only candidates are archived, because the history of what was released stays"
        )
    })
}

/// Generates the handlers. An entry states, in this order: doc comment, function name, change, the function in `access` that reads the row,
/// the kind of item and the field with its robot's id, the path and its id parameter, tag and operation id, the description and type of the
/// answer, and optionally the function that returns a reason against the change.
macro_rules! handlers {
    ($($(#[$doc:meta])+ $name:ident: $change:ident $row:ident $kind:ident $robot_id:ident, $path:tt $id:tt, $tag:tt $operation:tt, $what:tt $answer:ident $(unless $reason:ident)?;)+) => {$(
        $(#[$doc])+
        #[utoipa::path(
            post, path = $path, tag = $tag, operation_id = $operation,
            params(($id = String, Path, description = $what)),
            responses((status = 200, description = $what, body = $answer))
        )]
        pub async fn $name(
            Id(id): Id,
            submission: Submission,
        ) -> Result<Response, Error> {
            let mut row = access::$row(&submission.app, &submission.caller, &id).await?;
            // Checked inside `effect`, so that a repeated request gets its first answer even if the item has changed since.
            let effect = async |tx: &mut Tx| {
                $(if let Some(detail) = $reason(&row) {
                    return Err(Error::conflict("not_archivable", detail));
                })?
                    let by = &submission.caller.holder;
                row.archived_at_ms = apply(tx, Change::$change, Archivable::$kind, &id, &row.$robot_id, by).await?;
                stored_json(200, None, &$answer::try_from(&row)?)
            };
            submission.create(effect).await
        }
    )+};
}

handlers! {
    /// Archives a robot: it is left out of lists and takes no uploads, jobs, edits, named documents, policies and releases. Withdrawing and rolling back stay possible.
    archive_robot: Archive robot Robot id, "/v1/robots/{robot_id}/archive" "robot_id", "robots" "archiveRobot", "The robot" RobotAnswer;
    /// Restores an archived robot: it is in lists and can be used again.
    restore_robot: Restore robot Robot id, "/v1/robots/{robot_id}/restore" "robot_id", "robots" "restoreRobot", "The robot" RobotAnswer;
    /// Archives a measurement set: it is left out of lists, and no new job uses it.
    archive_measurement_set: Archive measurement_set MeasurementSet robot_id, "/v1/measurement-sets/{id}/archive" "id", "measurement sets" "archiveMeasurementSet", "The measurement set" SetSummary;
    /// Restores an archived measurement set: it is in lists and can be used again.
    restore_measurement_set: Restore measurement_set MeasurementSet robot_id, "/v1/measurement-sets/{id}/restore" "id", "measurement sets" "restoreMeasurementSet", "The measurement set" SetSummary;
    /// Archives a job that has ended: it is left out of lists. Its results stay evidence.
    archive_job: Archive job Job robot_id, "/v1/jobs/{id}/archive" "id", "jobs" "archiveJob", "The job" JobAnswer unless still_runs;
    /// Restores an archived job: it is in lists and can be used again.
    restore_job: Restore job Job robot_id, "/v1/jobs/{id}/restore" "id", "jobs" "restoreJob", "The job" JobAnswer;
    /// Archives a candidate: it is left out of lists, cannot be released, and is not compared with. A set that was released is never archived.
    archive_parameter_set: Archive parameter_set ParameterSet robot_id, "/v1/parameter-sets/{id}/archive" "id", "parameter sets" "archiveParameterSet", "The parameter set" ParameterSetAnswer unless was_released;
    /// Restores an archived parameter set: it is in lists and can be used again.
    restore_parameter_set: Restore parameter_set ParameterSet robot_id, "/v1/parameter-sets/{id}/restore" "id", "parameter sets" "restoreParameterSet", "The parameter set" ParameterSetAnswer;
    /// Archives a network: it is left out of lists, and no new job starts from it.
    archive_network: Archive network Network robot_id, "/v1/networks/{id}/archive" "id", "networks" "archiveNetwork", "The network" NetworkAnswer;
    /// Restores an archived network: it is in lists and can be used again.
    restore_network: Restore network Network robot_id, "/v1/networks/{id}/restore" "id", "networks" "restoreNetwork", "The network" NetworkAnswer;
}
