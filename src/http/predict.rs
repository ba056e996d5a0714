//! Predicted positions of a target on an identified robot.

use crate::calibration::INSTRUMENT_SCALE;
use crate::http::extract::{Item, json_body};
use crate::http::{Error, access, parameter_sets};
use crate::operations;
use crate::release::wrong_robot;
use crate::wire::json;
use crate::wire::measurement::Warning;
use crate::wire::predict::{PredictAnswer, PredictBody};
use crate::wire::robot::Robot;
use axum::Json;
use axum::extract::Request;

/// Predicted positions of a target in the set's measuring frame, for the controller's joint values.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/predict", tag = "parameter sets", operation_id = "predict",
    params(("id" = String, Path, description = "The parameter set")), request_body = PredictBody,
    responses((status = 200, description = "Positions, pose by pose", body = PredictAnswer))
)]
pub async fn predict(
    Item { app, caller, id }: Item,
    request: Request,
) -> Result<Json<PredictAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let robot = access::robot_of_set(&app, &caller, &row).await?;
    let bytes = json_body(request, &app).await?;
    let content = parameter_sets::content(&row)?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let estimate = parameter_sets::estimate(&app, &permit, &row, &robot).await?;
    let mut warnings = parameter_sets::warnings_of_use(&app, &row).await?;
    let provenance = parameter_sets::provenance(&app, &permit, &row).await?;
    let is_wrong =
        |warning: &Warning| wrong_robot(&provenance).is_some_and(|(code, _)| code == warning.code);
    let is_shown = |warning: &&Warning| is_wrong(warning) || warning.code == INSTRUMENT_SCALE;
    warnings.extend(provenance.warnings.iter().filter(is_shown).cloned());
    let answer = permit.run(move || {
        let body: PredictBody = json::parse(&bytes)?;
        let robot = Robot::try_from(&robot)?;
        Ok::<_, Error>(operations::predict(
            &body,
            &robot,
            &content,
            estimate.as_ref(),
        )?)
    });
    let answer = answer.await?;
    Ok(Json(PredictAnswer { warnings, ..answer }))
}
