//! Corrected joint targets.

use crate::http::auth::Caller;
use crate::http::extract::{Id, json_body};
use crate::http::limits::RequestClass;
use crate::http::{App, Error, access, parameter_sets};
use crate::operations;
use crate::wire::compensate::{CompensateAnswer, CompensateBody};
use crate::wire::json;
use crate::wire::robot::Robot;
use axum::Json;
use axum::extract::{Request, State};
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of corrected targets.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(compensate))
}

/// Corrects joint targets: with the answered joint values the real robot has its tool where the nominal robot has it with the requested ones.
/// Send only targets that were programmed offline: taught targets already contain the robot's errors.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/compensate", tag = "parameter sets", operation_id = "compensate",
    params(("id" = String, Path, description = "The parameter set")), request_body = CompensateBody,
    responses((status = 200, description = "Corrected targets, in the order of the request", body = CompensateAnswer))
)]
async fn compensate(
    State(app): State<App>,
    caller: Caller,
    Id(id): Id,
    request: Request,
) -> Result<Json<CompensateAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let robot = access::robot_of_set(&app, &caller, &row).await?;
    let bytes = json_body(request, &app).await?;
    let content = parameter_sets::content(&row)?;
    let permit = app.limits.compute(RequestClass::Calculation).await?;
    let provenance = parameter_sets::provenance(&app, &permit, &row).await?;
    let answer = permit.run(move || {
        let body: CompensateBody = json::parse(&bytes)?;
        let robot = Robot::try_from(&robot)?;
        Ok::<_, Error>(operations::compensate(
            &body,
            &robot,
            &content,
            &provenance,
        )?)
    });
    Ok(Json(answer.await?))
}
