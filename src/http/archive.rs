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
trait Item: Clone + Sync {
    const KIND: Archivable;
    type Answer: Serialize;

    fn id(&self) -> &str;

    fn robot_id(&self) -> &str;

    /// Reason, if the item cannot be archived.
    fn not_archivable(&self) -> Option<String>;

    /// The answer, with the time at which the item was archived, or `None`.
    fn answer(&self, archived_at_ms: Option<i64>) -> Result<Self::Answer, Error>;
}

/// Implements [`Item`] for a row. The arguments are the kind, the field with the id of its robot, the answer and its
/// conversion, and the reason if the row cannot be archived.
macro_rules! item {
    ($row:ident $kind:ident $robot_id:ident $answer:ident, $convert:expr, $not_archivable:expr) => {
        impl Item for $row {
            const KIND: Archivable = Archivable::$kind;
            type Answer = $answer;

            fn id(&self) -> &str {
                &self.id
            }

            fn robot_id(&self) -> &str {
                &self.$robot_id
            }

            fn not_archivable(&self) -> Option<String> {
                let reason: fn(&$row) -> Option<String> = $not_archivable;
                reason(self)
            }

            fn answer(&self, archived_at_ms: Option<i64>) -> Result<$answer, Error> {
                let mut row = self.clone();
                row.archived_at_ms = archived_at_ms;
                let convert: fn($row) -> Result<$answer, Error> = $convert;
                convert(row)
            }
        }
    };
}

item!(RobotRow Robot id RobotAnswer, |row| RobotAnswer::try_from(&row), |_| None);
item!(MeasurementSetRow MeasurementSet robot_id SetSummary, |row| SetSummary::try_from(&row), |_| None);
item!(NetworkRow Network robot_id NetworkAnswer, NetworkAnswer::try_from, |_| None);
item!(JobRow Job robot_id JobAnswer, |row| JobAnswer::try_from(&row), |row| {
    let status = row.status.as_str();
    (!row.status.is_over())
        .then(|| format!("the job is {status}: wait until it is over, or cancel it"))
});
item!(ParameterSetRow ParameterSet robot_id ParameterSetAnswer, ParameterSetAnswer::try_from, |row| {
    let status = row.status.as_str();
    let was_released = row.status != ParameterSetStatus::Candidate && row.archived_at_ms.is_none();
    was_released.then(|| {
        format!(
            "the parameter set is {status}; only candidates are archived, because the history of what was released stays"
        )
    })
});

/// Archives or restores an item.
async fn change_item(
    app: &App,
    submission: &Submission,
    change: Change,
    item: impl Item,
) -> Result<Response, Error> {
    let effect = async |tx: &mut Tx| {
        let archived_at_ms = change_in(tx, &item, change, &submission.caller.holder).await?;
        stored_json(200, None, &item.answer(archived_at_ms)?)
    };
    submission.create(&app.store, effect).await
}

/// Returns when the item was archived, if it is.
async fn change_in<I: Item>(
    tx: &mut Tx,
    item: &I,
    change: Change,
    by: &str,
) -> Result<Option<i64>, Error> {
    let (id, robot_id) = (item.id(), item.robot_id());
    match (change, item.not_archivable()) {
        (Change::Archive, Some(detail)) => Err(Error::Conflict {
            code: "not_archivable",
            detail,
            errors: vec![],
        }),
        (Change::Archive, None) => Ok(Some(archive::archive(tx, I::KIND, id, robot_id, by).await?)),
        (Change::Restore, _) => {
            archive::restore(tx, I::KIND, id, robot_id).await?;
            Ok(None)
        }
    }
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
            let item = access::$kind(&app, &submission.caller, &id).await?;
            change_item(&app, &submission, Change::$change, item).await
        }
    )+};
}

handlers! {
    /// Archives a robot: it is left out of lists and takes no uploads, jobs, edits, named documents, policies and releases. Withdrawing and rolling back stay possible.
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
