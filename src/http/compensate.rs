//! Corrected joint targets.

use crate::http::auth::Caller;
use crate::http::extract::{Id, json_body};
use crate::http::{App, Error, access, named_frames, parameter_sets};
use crate::operations::{self, Correctable};
use crate::store::jobs;
use crate::wire::compensate::{CompensateAnswer, CompensateBody, OWN_FRAMES};
use crate::wire::issue::Invalid;
use crate::wire::json;
use crate::wire::measurement::Frame;
use crate::wire::robot::Robot;
use axum::Json;
use axum::extract::{Request, State};

/// Corrects joint or Cartesian targets, so that the real robot reaches them.
///
/// For joint targets (`q_deg`) the answer has joint values. With these, the real robot puts its tool where the nominal robot puts it with the
/// requested values. For Cartesian targets (`targets` in `frame`) the answer has the joint values and the poses that put the real robot's tool there.
/// Send only targets that were programmed offline: taught targets already contain the robot's errors.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/compensate", tag = "parameter sets", operation_id = "compensate",
    params(("id" = String, Path, description = "The parameter set")), request_body = CompensateBody,
    responses((status = 200, description = "Corrected targets, in the order of the request", body = CompensateAnswer))
)]
pub async fn compensate(
    State(app): State<App>,
    caller: Caller,
    Id(id): Id,
    request: Request,
) -> Result<Json<CompensateAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let robot = access::robot_of_set(&app, &caller, &row).await?;
    let bytes = json_body(request, &app).await?;
    let content = parameter_sets::content(&row)?;
    let permit = app.limits.compute(caller.class).await?;
    let provenance = parameter_sets::provenance(&app, &permit, &row).await?;
    let estimate = parameter_sets::estimate(&app, &permit, &row, &robot).await?;
    let mut warnings = parameter_sets::warnings_of_use(&app, &row).await?;
    let job = jobs::get(&app.store, &row.job_id).await?;
    // the measurement set that defines the measuring frame of the parameter set
    let measurement_set_id = match provenance.measuring_frame {
        Some(Frame::Instrument) => job.set_ids().last().map(str::to_owned),
        _ => Some(job.measurement_set_id),
    };
    let body = permit.run(move || Ok::<_, Error>(json::parse::<CompensateBody>(&bytes)?));
    let body = body.await?;
    let work_frame = match body.frame.as_deref() {
        None => None,
        Some(name) if OWN_FRAMES.contains(&name) => None,
        Some(name) => {
            let found = named_frames::work_frame(&app, &row.robot_id, name).await;
            Some(found.map_err(|error| unknown_name(error, "/frame", "work frame", name))?)
        }
    };
    let named_tool = match &body.tool_name {
        None => None,
        Some(name) => {
            let found = named_frames::tool(&app, &row.robot_id, name).await;
            Some(found.map_err(|error| unknown_name(error, "/tool_name", "tool", name))?)
        }
    };
    let answer = permit.run(move || {
        let robot = Robot::try_from(&robot)?;
        let from = Correctable {
            robot: &robot,
            content: &content,
            provenance: &provenance,
            estimate: estimate.as_ref(),
            measurement_set_id: measurement_set_id.as_deref(),
            work_frame: work_frame.as_ref(),
            named_tool,
        };
        Ok::<_, Error>(operations::compensate(&body, from)?)
    });
    let mut answer = answer.await?;
    warnings.append(&mut answer.warnings);
    Ok(Json(CompensateAnswer { warnings, ..answer }))
}

/// A name in the body that the robot does not have is wrong input, not a missing resource.
fn unknown_name(error: Error, at: &str, what: &str, name: &str) -> Error {
    let Error::NotFound(_) = error else {
        return error;
    };
    let shown: String = name.chars().take(40).collect();
    let detail = format!("the robot has no {what} called {shown:?}");
    Invalid::at(at, "unknown_reference", detail).into()
}
