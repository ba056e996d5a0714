//! Work frames and tools of a robot, each under a name.

use crate::http::auth::Caller;
use crate::http::creation::Submission;
use crate::http::job_sources::require_own;
use crate::http::list_query::{NewestListQuery, list_of_robot};
use crate::http::measurement_sets::points_of;
use crate::http::named_documents::DocumentAnswer;
use crate::http::{App, Error, access, named_documents};
use crate::operations::{check_new_work_frame, check_station, work_frame_answer};
use crate::store::named_documents::NamedDocumentKind;
use crate::store::{self, NamedDocumentRow, measurement_sets};
use crate::wire::id;
use crate::wire::named_frame::{ToolAnswer, WorkFrameAnswer, WorkFrameBody, check_name};
use crate::wire::page::Page;
use crate::wire::robot::MAX_NAME;
use crate::wire::time::rfc3339;
use crate::wire::tool::ToolBody;
use axum::Json;
use axum::extract::{Path, State};
use axum::response::Response;
use serde::de::DeserializeOwned;

list_of_robot! {
    /// A robot's work frames, newest first.
    list_work_frames: "/v1/robots/{robot_id}/work-frames" "robots" "listWorkFrames", NewestListQuery WorkFrameAnswer, store::named_documents::list, NamedDocumentKind::WorkFrame
}

/// A work frame by its name.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/work-frames/{name}", tag = "robots", operation_id = "getWorkFrame",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The work frame's name")),
    responses((status = 200, description = "The work frame", body = WorkFrameAnswer))
)]
pub async fn get_work_frame(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, name)): Path<(String, String)>,
) -> Result<Json<WorkFrameAnswer>, Error> {
    named_documents::get(&app, &caller, &robot_id, &name).await
}

/// Stores a work frame under a name: typed, or fitted to three or more measured points. Points that do not fit the drawing are refused (422
/// `work_frame_does_not_fit`). It replaces an earlier one of that name.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/work-frames/{name}", tag = "robots", operation_id = "putWorkFrame",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The work frame's name")),
    request_body = WorkFrameBody,
    responses((status = 200, description = "The work frame, stored, with the residuals of its points", body = WorkFrameAnswer))
)]
pub async fn put_work_frame(
    Path((robot_id, name)): Path<(String, String)>,
    submission: Submission,
) -> Result<Response, Error> {
    let app = &submission.app;
    let body: WorkFrameBody = checked_body(&robot_id, &name, &submission).await?;
    check_new_work_frame(&body)?;
    if let Some(set_id) = &body.measurement_set_id {
        let (at, what) = ("/measurement_set_id", "measurement set");
        id::check(at, set_id, what)?;
        let set = measurement_sets::get(&app.store, set_id).await;
        let set = require_own(set, |set| set.robot_id == robot_id, at, what)?;
        let robot = access::robot(app, &submission.caller, &robot_id).await?;
        let n_joints = access::robot_body(&robot)?.links.len();
        let permit = app.limits.compute_permit(submission.caller.class).await?;
        let points = points_of(app, &permit, set, n_joints).await?;
        check_station(&body, &points)?;
    }
    named_documents::put::<WorkFrameAnswer>(&robot_id, &name, &submission, body).await
}

list_of_robot! {
    /// A robot's tools, newest first.
    list_tools: "/v1/robots/{robot_id}/tools" "robots" "listTools", NewestListQuery ToolAnswer, store::named_documents::list, NamedDocumentKind::Tool
}

/// A tool by its name.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/tools/{name}", tag = "robots", operation_id = "getTool",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The tool's name")),
    responses((status = 200, description = "The tool", body = ToolAnswer))
)]
pub async fn get_tool(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, name)): Path<(String, String)>,
) -> Result<Json<ToolAnswer>, Error> {
    named_documents::get(&app, &caller, &robot_id, &name).await
}

/// Stores a tool (`t_flange_tool`: tool centre point and orientation in the flange frame) under a name. It replaces an earlier one of that name.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/tools/{name}", tag = "robots", operation_id = "putTool",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The tool's name")),
    request_body = ToolBody,
    responses((status = 200, description = "The tool, stored", body = ToolAnswer))
)]
pub async fn put_tool(
    Path((robot_id, name)): Path<(String, String)>,
    submission: Submission,
) -> Result<Response, Error> {
    let body: ToolBody = checked_body(&robot_id, &name, &submission).await?;
    body.check()?;
    named_documents::put::<ToolAnswer>(&robot_id, &name, &submission, body).await
}

/// The body of a request that stores a work frame or a tool. Checks the name and the robot first.
async fn checked_body<B: DeserializeOwned>(
    robot_id: &str,
    name: &str,
    submission: &Submission,
) -> Result<B, Error> {
    check_name(name, MAX_NAME)?;
    access::robot_in_use(&submission.app, &submission.caller, robot_id).await?;
    submission.json()
}

/// The newest work frame of this name.
pub async fn work_frame(app: &App, robot_id: &str, name: &str) -> Result<WorkFrameBody, Error> {
    let row = named_documents::newest(app, robot_id, NamedDocumentKind::WorkFrame, name).await?;
    Ok(serde_json::from_str(&row.content_json)?)
}

/// The newest tool of this name.
pub async fn tool(app: &App, robot_id: &str, name: &str) -> Result<ToolBody, Error> {
    let row = named_documents::newest(app, robot_id, NamedDocumentKind::Tool, name).await?;
    Ok(serde_json::from_str(&row.content_json)?)
}

impl DocumentAnswer for WorkFrameAnswer {
    const KIND: NamedDocumentKind = NamedDocumentKind::WorkFrame;
}

impl TryFrom<&NamedDocumentRow> for WorkFrameAnswer {
    type Error = Error;

    fn try_from(row: &NamedDocumentRow) -> Result<Self, Error> {
        let body: WorkFrameBody = serde_json::from_str(&row.content_json)?;
        let created_at = rfc3339(row.created_at_ms);
        Ok(work_frame_answer(body, row.name.clone(), created_at)?)
    }
}

impl DocumentAnswer for ToolAnswer {
    const KIND: NamedDocumentKind = NamedDocumentKind::Tool;
}

impl TryFrom<&NamedDocumentRow> for ToolAnswer {
    type Error = Error;

    fn try_from(row: &NamedDocumentRow) -> Result<Self, Error> {
        let body: ToolBody = serde_json::from_str(&row.content_json)?;
        Ok(body.answer(row.name.clone(), rfc3339(row.created_at_ms)))
    }
}
