//! Release policies of robots.

use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Item};
use crate::http::{Error, access};
use crate::jobs::evidence::policy_in_force;
use crate::store::{Tx, policies};
use crate::wire::policy::PolicyBody;
use axum::Json;
use axum::response::Response;

/// The robot's release policy. The default requires nothing beyond the gates that always hold.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/policy", tag = "robots", operation_id = "getPolicy",
    params(("robot_id" = String, Path, description = "The robot")),
    responses((status = 200, description = "The policy", body = PolicyBody))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<PolicyBody>, Error> {
    access::robot(&app, &caller, &id).await?;
    Ok(Json(policy_in_force(
        &policies::get(&app.store, &id).await?,
    )))
}

/// Sets the robot's release policy; requires the scope `admin`.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/policy", tag = "robots", operation_id = "putPolicy",
    params(("robot_id" = String, Path, description = "The robot")), request_body = PolicyBody,
    responses((status = 200, description = "The policy, stored", body = PolicyBody))
)]
pub async fn put(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    access::robot_in_use(&submission.app, &submission.caller, &robot_id).await?;
    let policy: PolicyBody = submission.json()?;
    policy.check()?;
    let by = &submission.caller.holder;
    let effect = async |tx: &mut Tx| {
        policies::put(tx, &robot_id, &policy, by).await?;
        stored_json(200, None, &policy)
    };
    submission.create(effect).await
}
