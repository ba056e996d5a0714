//! Work frames and tools of a robot, kept under a name.

use crate::http::auth::Caller;
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Query};
use crate::http::list_query::NewestListQuery;
use crate::http::{App, Error, access};
use crate::store::named_frames::NewNamedFrame;
use crate::store::{self, NamedFrameRow, Tx, measurement_sets, named_frames};
use crate::wire::named_frame::{
    NamedFrameKind, ToolAnswer, WorkFrameAnswer, WorkFrameBody, check_name,
};
use crate::wire::page::Page;
use crate::wire::robot::MAX_NAME;
use crate::wire::time::rfc3339;
use crate::wire::tool::ToolBody;
use axum::Json;
use axum::extract::{Path, State};
use axum::response::Response;
use serde::Serialize;
use serde::de::DeserializeOwned;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of work frames and tools.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(list_work_frames))
        .routes(routes!(get_work_frame, put_work_frame))
        .routes(routes!(list_tools))
        .routes(routes!(get_tool, put_tool))
}

/// A robot's work frames, newest first.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/work-frames", tag = "robots", operation_id = "listWorkFrames",
    params(("robot_id" = String, Path, description = "The robot"), NewestListQuery),
    responses((status = 200, description = "One page", body = Page<WorkFrameAnswer>))
)]
async fn list_work_frames(
    State(app): State<App>,
    caller: Caller,
    Id(robot_id): Id,
    Query(query): Query<NewestListQuery>,
) -> Result<Json<Page<WorkFrameAnswer>>, Error> {
    page(&app, &caller, &robot_id, NamedFrameKind::WorkFrame, query).await
}

/// A work frame by its name.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/work-frames/{name}", tag = "robots", operation_id = "getWorkFrame",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The work frame's name")),
    responses((status = 200, description = "The work frame", body = WorkFrameAnswer))
)]
async fn get_work_frame(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, name)): Path<(String, String)>,
) -> Result<Json<WorkFrameAnswer>, Error> {
    one(&app, &caller, &robot_id, NamedFrameKind::WorkFrame, &name).await
}

/// Keeps a work frame under a name, in place of an earlier one of that name: typed, or fitted to three or more measured points.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/work-frames/{name}", tag = "robots", operation_id = "putWorkFrame",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The work frame's name")),
    request_body = WorkFrameBody,
    responses((status = 200, description = "The work frame, stored, with the residuals of its points", body = WorkFrameAnswer))
)]
async fn put_work_frame(
    State(app): State<App>,
    Path((robot_id, name)): Path<(String, String)>,
    submission: Submission,
) -> Result<Response, Error> {
    let body: WorkFrameBody = begin(&app, &robot_id, &name, &submission).await?;
    body.work_frame()?;
    if let Some(id) = &body.measurement_set_id {
        let set = measurement_sets::get(&app.store, id).await;
        if !set.is_ok_and(|set| set.robot_id == robot_id) {
            return Err(Error::NotFound("measurement set of this robot"));
        }
    }
    let named = (robot_id.as_str(), NamedFrameKind::WorkFrame, name.as_str());
    keep::<_, WorkFrameAnswer>(&app, named, submission, body).await
}

/// A robot's tools, newest first.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/tools", tag = "robots", operation_id = "listTools",
    params(("robot_id" = String, Path, description = "The robot"), NewestListQuery),
    responses((status = 200, description = "One page", body = Page<ToolAnswer>))
)]
async fn list_tools(
    State(app): State<App>,
    caller: Caller,
    Id(robot_id): Id,
    Query(query): Query<NewestListQuery>,
) -> Result<Json<Page<ToolAnswer>>, Error> {
    page(&app, &caller, &robot_id, NamedFrameKind::Tool, query).await
}

/// A tool by its name.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/tools/{name}", tag = "robots", operation_id = "getTool",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The tool's name")),
    responses((status = 200, description = "The tool", body = ToolAnswer))
)]
async fn get_tool(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, name)): Path<(String, String)>,
) -> Result<Json<ToolAnswer>, Error> {
    one(&app, &caller, &robot_id, NamedFrameKind::Tool, &name).await
}

/// Keeps a tool (`t_flange_tool`: tool centre point and orientation in the flange frame) under a name, in place of an earlier one of that name.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/tools/{name}", tag = "robots", operation_id = "putTool",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The tool's name")),
    request_body = ToolBody,
    responses((status = 200, description = "The tool, stored", body = ToolAnswer))
)]
async fn put_tool(
    State(app): State<App>,
    Path((robot_id, name)): Path<(String, String)>,
    submission: Submission,
) -> Result<Response, Error> {
    let body: ToolBody = begin(&app, &robot_id, &name, &submission).await?;
    body.check()?;
    let named = (robot_id.as_str(), NamedFrameKind::Tool, name.as_str());
    keep::<_, ToolAnswer>(&app, named, submission, body).await
}

async fn page<A>(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    kind: NamedFrameKind,
    query: NewestListQuery,
) -> Result<Json<Page<A>>, Error>
where
    A: for<'r> TryFrom<&'r NamedFrameRow, Error = Error>,
{
    access::robot(app, caller, robot_id).await?;
    let found = named_frames::list(&app.store, robot_id, kind, &query.request()?).await?;
    let convert = |row| A::try_from(&row);
    Ok(Json(found.page.into_answer(found.total, convert)?))
}

async fn one<A>(
    app: &App,
    caller: &Caller,
    robot_id: &str,
    kind: NamedFrameKind,
    name: &str,
) -> Result<Json<A>, Error>
where
    A: for<'r> TryFrom<&'r NamedFrameRow, Error = Error>,
{
    access::robot(app, caller, robot_id).await?;
    let row = newest(app, robot_id, kind, name).await?;
    Ok(Json(A::try_from(&row)?))
}

/// The body of a request that puts a work frame or tool of this name, if the caller may see the robot.
async fn begin<B: DeserializeOwned>(
    app: &App,
    robot_id: &str,
    name: &str,
    submission: &Submission,
) -> Result<B, Error> {
    check_name(name, MAX_NAME)?;
    access::robot(app, &submission.caller, robot_id).await?;
    submission.json()
}

/// Stores the checked body of a request under the robot's id, the kind and the name.
async fn keep<B, A>(
    app: &App,
    (robot_id, kind, name): (&str, NamedFrameKind, &str),
    submission: Submission,
    body: B,
) -> Result<Response, Error>
where
    B: Serialize,
    A: for<'r> TryFrom<&'r NamedFrameRow, Error = Error> + Serialize,
{
    let new = NewNamedFrame {
        robot_id,
        kind,
        name,
        content_json: &serde_json::to_string(&body)?,
        by: &submission.caller.holder,
    };
    let effect = async |tx: &mut Tx| {
        let row = named_frames::insert(tx, new).await?;
        stored_json(200, None, &A::try_from(&row)?)
    };
    submission.create(&app.store, effect).await
}

async fn newest(
    app: &App,
    robot_id: &str,
    kind: NamedFrameKind,
    name: &str,
) -> Result<NamedFrameRow, Error> {
    // no frame or tool has a name that cannot be kept
    if check_name(name, MAX_NAME).is_err() {
        return Err(Error::NotFound("work frame or tool"));
    }
    let row = named_frames::newest(&app.store, robot_id, kind, name).await;
    row.map_err(|error| match (error, kind) {
        (store::Error::NotFound, NamedFrameKind::WorkFrame) => Error::NotFound("work frame"),
        (store::Error::NotFound, NamedFrameKind::Tool) => Error::NotFound("tool"),
        (other, _) => other.into(),
    })
}

/// The work frame that holds under a name.
pub async fn work_frame(app: &App, robot_id: &str, name: &str) -> Result<WorkFrameBody, Error> {
    let row = newest(app, robot_id, NamedFrameKind::WorkFrame, name).await?;
    Ok(serde_json::from_str(&row.content_json)?)
}

/// The tool that holds under a name.
pub async fn tool(app: &App, robot_id: &str, name: &str) -> Result<ToolBody, Error> {
    let row = newest(app, robot_id, NamedFrameKind::Tool, name).await?;
    Ok(serde_json::from_str(&row.content_json)?)
}

impl TryFrom<&NamedFrameRow> for WorkFrameAnswer {
    type Error = Error;

    fn try_from(row: &NamedFrameRow) -> Result<Self, Error> {
        let body: WorkFrameBody = serde_json::from_str(&row.content_json)?;
        Ok(body.answer(row.name.clone(), rfc3339(row.created_at_ms))?)
    }
}

impl TryFrom<&NamedFrameRow> for ToolAnswer {
    type Error = Error;

    fn try_from(row: &NamedFrameRow) -> Result<Self, Error> {
        let body: ToolBody = serde_json::from_str(&row.content_json)?;
        Ok(body.answer(row.name.clone(), rfc3339(row.created_at_ms)))
    }
}
