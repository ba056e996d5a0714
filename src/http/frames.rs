//! Base and tool frame, computed from sweeps of single joints.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Item};
use crate::http::{Error, access};
use crate::operations::frames_from_sweeps;
use crate::store::{FramesRow, NewFrames, Tx, frames};
use crate::wire::frames::{FramesAnswer, FramesContent};
use crate::wire::robot::Robot;
use crate::wire::time::rfc3339;
use axum::Json;
use axum::response::Response;

/// Finds base and tool frame from sweeps of single joints (section 2.2 of the paper).
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/frames", tag = "frames", operation_id = "createFrames",
    params(("robot_id" = String, Path, description = "The robot")),
    request_body(description = "As a measurement set in the instrument's frame, plus the column `sweep_joint`", content((String = "text/csv"))),
    responses((status = 201, description = "Base and tool frame", body = FramesAnswer, headers(("Location" = String, description = "Their path"))))
)]
pub async fn create(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    let app = &submission.app;
    let robot = access::robot_in_use(app, &submission.caller, &robot_id).await?;
    if submission.media_type != "text/csv" {
        return Err(submission.unsupported("text/csv"));
    }
    let (robot, bytes) = (access::robot_body(&robot)?, submission.body.clone());
    let content_type = submission.content_type.clone();
    let new_frames = move || {
        let content = frames_from_sweeps(&bytes, &Robot::try_from(&robot)?)?;
        Ok::<_, Error>(NewFrames {
            robot_id,
            content_type,
            body: bytes.to_vec().into(),
            result_json: serde_json::to_string(&content)?,
        })
    };
    let new = app.compute(submission.caller.class, new_frames).await?;
    let effect = async |tx: &mut Tx| {
        let row = frames::insert(tx, &new).await?;
        stored_json(
            201,
            Some(format!("/v1/frames/{}", row.id)),
            &FramesAnswer::try_from(&row)?,
        )
    };
    submission.create(effect).await
}

/// Stored frames.
#[utoipa::path(
    get, path = "/v1/frames/{id}", tag = "frames", operation_id = "getFrames", params(("id" = String, Path, description = "The frames")),
    responses((status = 200, description = "Base and tool frame", body = FramesAnswer))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<FramesAnswer>, Error> {
    let row = access::frames(&app, &caller, &id).await?;
    Ok(Json((&row).try_into()?))
}

impl TryFrom<&FramesRow> for FramesAnswer {
    type Error = Error;

    fn try_from(row: &FramesRow) -> Result<Self, Error> {
        let FramesContent {
            t_instrument_base,
            z_tool_mm,
            circles,
        } = serde_json::from_str(&row.result_json)?;
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            t_instrument_base,
            z_tool_mm,
            circles,
            created_at: rfc3339(row.created_at_ms),
        })
    }
}
