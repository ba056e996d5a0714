//! Pose plans: the poses to measure next.

use crate::http::extract::{Item, json_body, parse_small};
use crate::http::job_sources::require_own;
use crate::http::measurement_sets::points_of;
use crate::http::{Error, access};
use crate::operations::plan_poses;
use crate::store::measurement_sets;
use crate::wire::pose_plan::{PosePlanAnswer, PosePlanBody};
use crate::wire::robot::Robot;
use axum::Json;
use axum::extract::Request;

/// Configurations that determine the robot's parameters best, within its joint limits. Nothing is stored.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/pose-plans", tag = "pose plans", operation_id = "planPoses",
    params(("robot_id" = String, Path, description = "The robot")), request_body = PosePlanBody,
    responses((status = 200, description = "The plan", body = PosePlanAnswer))
)]
pub async fn create(
    Item { app, caller, id }: Item,
    request: Request,
) -> Result<Json<PosePlanAnswer>, Error> {
    let row = access::robot(&app, &caller, &id).await?;
    let bytes = json_body(request, &app).await?;
    let body: PosePlanBody = parse_small(&bytes)?;
    body.check()?;
    let mut measured = Vec::new();
    for (i, id) in body.measured.iter().enumerate() {
        let found = measurement_sets::get(&app.store, id).await; // `check` has verified that it can be an id
        measured.push(require_own(
            found,
            |set| set.robot_id == row.id,
            &format!("/measured/{i}"),
            "measurement set",
        )?);
    }
    let robot = Robot::try_from(&access::robot_body(&row)?)?;
    let n_joints = robot.links.len();
    let permit = app.limits.compute_permit(caller.class).await?;
    let mut sets = Vec::new();
    for set in measured {
        // One after the other, because the bytes are much larger than the parsed points.
        sets.push(points_of(&app, &permit, set, n_joints).await?);
    }
    Ok(Json(
        permit.run(move || plan_poses(&body, &robot, &sets)).await?,
    ))
}
