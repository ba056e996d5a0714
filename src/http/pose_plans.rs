//! Which poses to measure next.

use crate::http::auth::Caller;
use crate::http::extract::{Id, aside_if_large, json_body};
use crate::http::job_posting::{frame_of, own};
use crate::http::{App, Error, access};
use crate::store::measurement_sets;
use crate::wire::json;
use crate::wire::measurement::from_upload;
use crate::wire::pose_plan::{PosePlanAnswer, PosePlanBody};
use axum::Json;
use axum::extract::{Request, State};
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of pose plans.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(create))
}

/// Configurations that tell most of the robot, within its joint limits; computed anew each time, nothing is stored.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/pose-plans", tag = "pose plans", operation_id = "planPoses",
    params(("robot_id" = String, Path, description = "The robot")), request_body = PosePlanBody,
    responses((status = 200, description = "The plan", body = PosePlanAnswer))
)]
async fn create(
    State(app): State<App>,
    caller: Caller,
    Id(robot_id): Id,
    request: Request,
) -> Result<Json<PosePlanAnswer>, Error> {
    let row = access::robot(&app, &caller, &robot_id).await?;
    let bytes = json_body(request, &app).await?;
    let body: PosePlanBody = aside_if_large(bytes.len(), || json::parse(&bytes))?;
    body.check()?;
    let mut measured = Vec::new();
    for (i, id) in body.measured.iter().enumerate() {
        let found = measurement_sets::get(&app.store, id).await; // `check` has looked whether it can be an id
        measured.push(own(
            found,
            |set| set.robot_id == row.id,
            &format!("/measured/{i}"),
            "measurement set",
        )?);
    }
    let robot = access::robot_body(&row)?.to_core()?;
    let n_joints = robot.links.len();
    let turn = app.turn().await?;
    let mut sets = Vec::new();
    for set in measured {
        // One after the other: their texts are much larger than what is in them.
        let points = measurement_sets::body(&app.store, &set.id).await?;
        sets.push(turn.run(|| {
            from_upload(&set.content_type, &points, frame_of(&set)?, n_joints)
                .map_err(Error::Invalid)
        })?);
    }
    Ok(Json(turn.run(|| body.run(&robot, &sets))?))
}
