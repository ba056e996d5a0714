//! The library of ready arms, and the posture check.

use crate::http::auth::Caller;
use crate::http::extract::{Id, Item, Query, json_body, parse_small};
use crate::http::list_query::checked_limit;
use crate::http::{Error, access};
use crate::operations;
use crate::operations::robot_models::{self, MAX_SEARCH_CHARS};
use crate::wire::posture::{PostureAnswer, PostureBody};
use crate::wire::robot::Robot;
use crate::wire::robot_model::{RobotModel, RobotModelPage};
use axum::Json;
use axum::extract::Request;
use serde::Deserialize;
use utoipa::IntoParams;

/// Query of the library.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ModelQuery {
    /// Words of the maker's and the arm's name; case, blanks and punctuation are ignored.
    #[param(max_length = 100)]
    search: Option<String>,
    /// The maker.
    #[param(max_length = 100)]
    maker: Option<String>,
    /// Items on the page.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Ready arms with their nominal links, by maker and name.
#[utoipa::path(
    get, path = "/v1/robot-models", tag = "robots", operation_id = "listRobotModels", params(ModelQuery),
    responses((status = 200, description = "One page", body = RobotModelPage))
)]
pub async fn list(
    _: Caller,
    Query(query): Query<ModelQuery>,
) -> Result<Json<RobotModelPage>, Error> {
    let limit = checked_limit(query.limit)?;
    for text in [&query.search, &query.maker].into_iter().flatten() {
        if text.chars().count() > MAX_SEARCH_CHARS {
            let detail = format!("at most {MAX_SEARCH_CHARS} characters are searched for");
            return Err(Error::invalid_query(detail));
        }
    }
    let found = robot_models::page(
        query.search.as_deref().unwrap_or_default(),
        query.maker.as_deref(),
        limit as usize,
        query.cursor.as_deref(),
    );
    let page = found.map_err(unreadable)?;
    page.map(Json).ok_or_else(|| {
        let detail = "no arm of this list is at the cursor: pass next_cursor on as it is, with the same search";
        Error::bad_request("invalid_cursor", detail)
    })
}

/// One ready arm: sources, frames, notes, and in `robot` the body of `POST /v1/robots`.
#[utoipa::path(
    get, path = "/v1/robot-models/{id}", tag = "robots", operation_id = "getRobotModel", params(("id" = String, Path, description = "The arm")),
    responses((status = 200, description = "The arm", body = RobotModel))
)]
pub async fn get(_: Caller, Id(id): Id) -> Result<Json<&'static RobotModel>, Error> {
    let found = robot_models::get(&id).map_err(unreadable)?;
    found.map(Json).ok_or(Error::NotFound("robot model"))
}

/// The nominal pose of the flange or a tool at the controller's joint values, to be compared with the pendant. Nothing is stored.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/posture", tag = "robots", operation_id = "checkPosture",
    params(("robot_id" = String, Path, description = "The robot")), request_body = PostureBody,
    responses((status = 200, description = "The pose in the base frame", body = PostureAnswer))
)]
pub async fn posture(
    Item { app, caller, id }: Item,
    request: Request,
) -> Result<Json<PostureAnswer>, Error> {
    let row = access::robot(&app, &caller, &id).await?;
    let bytes = json_body(request, &app).await?;
    let robot = access::robot_body(&row)?;
    let answer = app.compute(caller.class, move || {
        let body: PostureBody = parse_small(&bytes)?;
        Ok(operations::posture(&body, &Robot::try_from(&robot)?)?)
    });
    Ok(Json(answer.await?))
}

fn unreadable(error: &'static str) -> Error {
    Error::Internal(format!("the library of robots cannot be read: {error}"))
}
