//! Robots.

use crate::http::auth::Caller;
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Item, Query};
use crate::http::list_query::NamedListQuery;
use crate::http::{App, Error, access};
use crate::store::{NewRobot, RobotEdit, RobotRow, Tx, robot_versions, robots};
use crate::wire::page::Page;
use crate::wire::parameter_set::ReasonBody;
use crate::wire::robot::{CheckedAnswer, Robot, RobotAnswer, RobotBody, RobotStateName};
use crate::wire::robot_patch::{EditedRobot, RobotPatchBody};
use crate::wire::time::rfc3339;
use axum::Json;
use axum::extract::State;
use axum::response::Response;

/// Stores a robot with its nominal links.
#[utoipa::path(
    post, path = "/v1/robots", tag = "robots", operation_id = "createRobot", request_body = RobotBody,
    responses((status = 201, description = "The robot, stored", body = RobotAnswer, headers(("Location" = String, description = "Its path"))))
)]
pub async fn create(submission: Submission) -> Result<Response, Error> {
    if submission.caller.robots.is_some() {
        return Err(Error::Forbidden(
            "this key is limited to certain robots, so it cannot make new ones",
        ));
    }
    let body: RobotBody = submission.json()?;
    Robot::try_from(&body)?;
    let new = NewRobot {
        name: body.name.clone(),
        body_json: serde_json::to_string(&body)?,
    };
    let effect = async |tx: &mut Tx| {
        let row = robots::insert(tx, &new).await?;
        stored_json(
            201,
            Some(format!("/v1/robots/{}", row.id)),
            &RobotAnswer::try_from(&row)?,
        )
    };
    submission.create(effect).await
}

/// The robots that the key may see.
#[utoipa::path(
    get, path = "/v1/robots", tag = "robots", operation_id = "listRobots", params(NamedListQuery),
    responses((status = 200, description = "One page", body = Page<RobotAnswer>))
)]
pub async fn list(
    State(app): State<App>,
    caller: Caller,
    Query(query): Query<NamedListQuery>,
) -> Result<Json<Page<RobotAnswer>>, Error> {
    let found = robots::search(&app.store, caller.robots.as_deref(), &query.request()?).await?;
    Ok(Json(found.into_answer()?))
}

/// One robot.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}", tag = "robots", operation_id = "getRobot", params(("robot_id" = String, Path, description = "The robot")),
    responses((status = 200, description = "The robot", body = RobotAnswer))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<RobotAnswer>, Error> {
    let row = access::robot(&app, &caller, &id).await?;
    Ok(Json((&row).try_into()?))
}

/// Edits a robot: name, serial number, description, mounting, joint limits, and the joint map as long as no parameter set was released.
///
/// The nominal links cannot be edited. Earlier results, and jobs that were posted before, keep the robot as it was.
#[utoipa::path(
    patch, path = "/v1/robots/{robot_id}", tag = "robots", operation_id = "editRobot",
    params(("robot_id" = String, Path, description = "The robot")), request_body = RobotPatchBody,
    responses((status = 200, description = "The robot, edited", body = RobotAnswer))
)]
pub async fn edit(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    let row = access::robot_in_use(&submission.app, &submission.caller, &robot_id).await?;
    let patch: RobotPatchBody = submission.json().map_err(explain_fixed_links)?;
    let EditedRobot {
        body,
        changed,
        changes_joint_map,
    } = patch.apply(&access::robot_body(&row)?)?;
    let edit = RobotEdit {
        edited_version: row.version,
        name: body.name.clone(),
        body_json: serde_json::to_string(&body)?,
        changes_joint_map,
        changed,
    };
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        let edited = match edit.changed.is_empty() {
            true => row.clone(),
            false => robot_versions::edit(tx, &robot_id, &edit, by).await?,
        };
        stored_json(200, None, &RobotAnswer::try_from(&edited)?)
    };
    submission.create(effect).await
}

/// Adds the remedy to the error of a request that tries to edit the links.
fn explain_fixed_links(error: Error) -> Error {
    match error {
        Error::Invalid(mut invalid) => {
            let of_links = invalid.issues.iter_mut().filter(|issue| {
                let pointer = issue.pointer.as_deref().unwrap_or_default();
                pointer.starts_with("/links") || issue.detail.contains("`links`")
            });
            of_links.for_each(|issue| {
                "the nominal links are not edited, because everything that was identified is relative to them: store a new robot, and archive this one"
                    .clone_into(&mut issue.detail);
            });
            Error::Invalid(invalid)
        }
        other => other,
    }
}

/// States a reason why the robot is in order although a session did not fit it, and ends the state `check_robot`.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/checked", tag = "robots", operation_id = "checkedRobot",
    params(("robot_id" = String, Path, description = "The robot")), request_body = ReasonBody,
    responses((status = 200, description = "The robot", body = RobotAnswer))
)]
pub async fn checked(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    // Archived robots are allowed, because a rollback is possible on them too.
    access::robot(&submission.app, &submission.caller, &robot_id).await?;
    let reason = submission.reason()?;
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        let row = robots::checked(tx, &robot_id, &reason, by).await?;
        stored_json(200, None, &RobotAnswer::try_from(&row)?)
    };
    submission.create(effect).await
}

impl TryFrom<&RobotRow> for RobotAnswer {
    type Error = Error;

    fn try_from(row: &RobotRow) -> Result<Self, Error> {
        let RobotBody {
            name,
            serial_number,
            description,
            links,
            mounting,
            joint_map,
        } = access::robot_body(row)?;
        let checked = row.checked_reason.as_ref().zip(row.checked_at_ms);
        Ok(Self {
            id: row.id.clone(),
            name,
            serial_number,
            description,
            links,
            mounting,
            joint_map,
            state: match row.check_job_id {
                Some(_) => RobotStateName::CheckRobot,
                None => RobotStateName::Ok,
            },
            check_job_id: row.check_job_id.clone(),
            checked: checked.map(|(reason, at_ms)| CheckedAnswer {
                reason: reason.clone(),
                by: row.checked_by.clone().unwrap_or_default(),
                at: rfc3339(at_ms),
            }),
            version: row.version,
            archived_at: row.archived_at_ms.map(rfc3339),
            created_at: rfc3339(row.created_at_ms),
        })
    }
}
