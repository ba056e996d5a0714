//! Corrected joint targets.

use crate::calibration::request::Estimate;
use crate::http::extract::{Item, Query, json_body, whole_body};
use crate::http::limits::ComputePermit;
use crate::http::table_upload::stated_columns;
use crate::http::{App, Error, access, named_frames, parameter_sets};
use crate::operations::program::{Poses, Program, ProgramTarget};
use crate::operations::{self, Correctable};
use crate::store::{ParameterSetRow, jobs};
use crate::wire::compensate::{
    Base, CompensateAnswer, CompensateBody, CorrectedProgram, Mode, OWN_FRAMES,
};
use crate::wire::content_type::rotation_convention;
use crate::wire::issue::Invalid;
use crate::wire::json;
use crate::wire::measurement::{Frame, Warning};
use crate::wire::multipart::FileBytes;
use crate::wire::named_frame::WorkFrameBody;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::{Robot, RobotBody};
use crate::wire::tool::ToolBody;
use axum::Json;
use axum::extract::Request;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde::Deserialize;
use utoipa::IntoParams;

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
    Item { app, caller, id }: Item,
    request: Request,
) -> Result<Json<CompensateAnswer>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let robot = access::robot_of_set(&app, &caller, &row).await?;
    let bytes = json_body(request, &app).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let body = permit.run(move || Ok::<_, Error>(json::parse::<CompensateBody>(&bytes)?));
    let body = body.await?;
    let stored = StoredInputs::load(&app, &permit, row, robot, &body).await?;
    let answer = permit.run(move || Ok::<_, Error>(stored.correct(&body)?));
    Ok(Json(answer.await?))
}

/// Query of a program.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ProgramQuery {
    /// Whether the tool's pose is corrected, or only its position.
    #[serde(default)]
    #[param(inline)]
    mode: Mode,
    /// As in `compensate`.
    #[param(inline)]
    base: Option<Base>,
    /// The frame of Cartesian targets, as in `compensate`; it is not used for joint targets.
    #[param(min_length = 1, max_length = 200)]
    frame: Option<String>,
    /// Use this reflector as the tool, 0-based.
    #[param(maximum = 31)]
    target: Option<usize>,
    /// The name of a stored tool of the robot.
    #[param(min_length = 1, max_length = 200)]
    tool_name: Option<String>,
    /// The tool centre point in the flange frame, x, mm; a coordinate that is left out is 0.
    tool_x_mm: Option<f64>,
    /// Its y, mm.
    tool_y_mm: Option<f64>,
    /// Its z, mm.
    tool_z_mm: Option<f64>,
    /// Convention of `rx_deg ry_deg rz_deg` of Cartesian targets: `intrinsic_xyz`, `extrinsic_xyz`, `intrinsic_zyx`, …, or `rotation_vector`. Never guessed.
    #[param(max_length = 40)]
    rotation: Option<String>,
    /// Mapping of the program's columns: in JSON, or the name of a mapping that the robot has.
    columns: Option<String>,
}

impl ProgramQuery {
    /// The request without targets.
    fn body(&self) -> CompensateBody {
        let tool_mm = [self.tool_x_mm, self.tool_y_mm, self.tool_z_mm];
        let has_tool = tool_mm.iter().any(Option::is_some);
        CompensateBody {
            mode: self.mode,
            base: self.base,
            frame: self.frame.clone(),
            target: self.target,
            tool_name: self.tool_name.clone(),
            tool: has_tool.then(|| ToolBody {
                translation_mm: tool_mm.map(Option::unwrap_or_default),
                ..ToolBody::default()
            }),
            ..CompensateBody::default()
        }
    }
}

/// Corrects the targets of a program: a table with joint targets, or with Cartesian targets and joint values near them.
///
/// The table is read as an upload is: any encoding, separator, decimal mark and comments. Of commanded and measured joint values the commanded ones are
/// targets. Cartesian targets have the columns `x_mm y_mm z_mm` and perhaps `quat_w quat_x quat_y quat_z`, or `rx_deg ry_deg rz_deg` with `rotation`.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/compensate-program", tag = "parameter sets", operation_id = "compensateProgram",
    params(("id" = String, Path, description = "The parameter set"), ProgramQuery),
    request_body(
        description = "The program",
        content(
            (String = "text/csv"),
            (FileBytes = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"),
            (FileBytes = "application/vnd.oasis.opendocument.spreadsheet")
        )
    ),
    responses((status = 200, description = "The program with corrected targets, and what was found for each", body = CorrectedProgram))
)]
pub async fn program(
    Item { app, caller, id }: Item,
    Query(query): Query<ProgramQuery>,
    request: Request,
) -> Result<Json<CorrectedProgram>, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let robot = access::robot_of_set(&app, &caller, &row).await?;
    let columns = stated_columns(&app, &row.robot_id, query.columns.as_deref()).await?;
    let rotation = query.rotation.as_deref();
    let rotation = rotation.map(rotation_convention).transpose()?;
    let bytes = whole_body(request, &app).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let n_joints = robot.links.len();
    let parse =
        move || Ok::<_, Error>(Program::parse(&bytes, &columns, rotation)?.of_joints(n_joints));
    let program = permit.run(parse);
    let program = program.await?;
    let mut body = query.body();
    // A program of joint targets ignores the robot's own frames (`base`, `measuring`). A work frame is refused later.
    let is_own = body
        .frame
        .as_deref()
        .is_some_and(|frame| OWN_FRAMES.contains(&frame));
    if program.poses() == Poses::None && is_own {
        body.frame = None;
    }
    let stored = StoredInputs::load(&app, &permit, row, robot, &body).await?;
    let answer = permit.run(move || Ok::<_, Error>(corrected(&program, body, &stored)?));
    Ok(Json(answer.await?))
}

fn corrected(
    program: &Program,
    body: CompensateBody,
    stored: &StoredInputs,
) -> Result<CorrectedProgram, Invalid> {
    let mut answer: Option<CompensateAnswer> = None;
    for (first, part) in program.requests(&body) {
        let next = stored.correct(&part).map_err(|invalid| Invalid {
            issues: program.placed(&invalid.issues, first),
            ..invalid
        })?;
        match &mut answer {
            Some(answer) => answer.extend(next),
            None => answer = Some(next),
        }
    }
    let answer = answer.unwrap_or_default();
    let q_deg = |target| match target {
        ProgramTarget::Joints(q_deg) => q_deg,
        ProgramTarget::Cartesian(target) => target.q_near_deg,
    };
    Ok(CorrectedProgram {
        program_base64: BASE64_STANDARD.encode(program.with(&answer)),
        is_workbook: program.is_workbook,
        joint_columns: program.joints.clone(),
        left_columns: program.other_poses.clone(),
        lines: program.lines(),
        program_q_deg: program.targets().into_iter().map(q_deg).collect(),
        corrected: answer,
    })
}

/// Everything stored that a correction needs.
struct StoredInputs {
    robot: RobotBody,
    content: ParameterSetContent,
    provenance: Provenance,
    estimate: Option<Estimate>,
    /// The measurement set that defines the measuring frame of the parameter set.
    measurement_set_id: Option<String>,
    work_frame: Option<WorkFrameBody>,
    named_tool: Option<ToolBody>,
    warnings: Vec<Warning>,
}

impl StoredInputs {
    async fn load(
        app: &App,
        permit: &ComputePermit,
        row: ParameterSetRow,
        robot: RobotBody,
        body: &CompensateBody,
    ) -> Result<Self, Error> {
        let content = parameter_sets::content(&row)?;
        let provenance = parameter_sets::provenance(app, permit, &row).await?;
        let estimate = parameter_sets::estimate(app, permit, &row, &robot).await?;
        let warnings = parameter_sets::warnings_of_use(app, &row).await?;
        let job = jobs::get(&app.store, &row.job_id).await?;
        let measurement_set_id = match provenance.measuring_frame {
            Some(Frame::Instrument) => job.set_ids().last().map(str::to_owned),
            _ => Some(job.measurement_set_id),
        };
        let work_frame = match body.frame.as_deref() {
            None => None,
            Some(name) if OWN_FRAMES.contains(&name) => None,
            Some(name) => {
                let found = named_frames::work_frame(app, &row.robot_id, name).await;
                Some(found.map_err(|error| unknown_name(error, "/frame", "work frame", name))?)
            }
        };
        let named_tool = match &body.tool_name {
            None => None,
            Some(name) => {
                let found = named_frames::tool(app, &row.robot_id, name).await;
                Some(found.map_err(|error| unknown_name(error, "/tool_name", "tool", name))?)
            }
        };
        Ok(Self {
            robot,
            content,
            provenance,
            estimate,
            measurement_set_id,
            work_frame,
            named_tool,
            warnings,
        })
    }

    fn correct(&self, body: &CompensateBody) -> Result<CompensateAnswer, Invalid> {
        let robot = Robot::try_from(&self.robot)?;
        let from = Correctable {
            robot: &robot,
            content: &self.content,
            provenance: &self.provenance,
            estimate: self.estimate.as_ref(),
            measurement_set_id: self.measurement_set_id.as_deref(),
            work_frame: self.work_frame.as_ref(),
            named_tool: self.named_tool,
        };
        let answer = operations::compensate(body, from)?;
        let warnings = self.warnings.iter().cloned().chain(answer.warnings);
        Ok(CompensateAnswer {
            warnings: warnings.collect(),
            ..answer
        })
    }
}

/// Converts a 404 for a name in the body to 422: the name is invalid input, not a missing resource.
fn unknown_name(error: Error, at: &str, what: &str, name: &str) -> Error {
    let Error::NotFound(_) = error else {
        return error;
    };
    let shown: String = name.chars().take(40).collect();
    let detail = format!("the robot has no {what} called {shown:?}");
    Invalid::at(at, "unknown_reference", detail).into()
}
