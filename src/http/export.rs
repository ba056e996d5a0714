//! Exports parameter sets to other formats, and imports robots from other formats.

use crate::http::auth::Caller;
use crate::http::extract::{Item, Query, whole_body};
use crate::http::limits::ComputePermit;
use crate::http::{App, Error, access, file_name, parameter_sets};
use crate::operations::export::{self, Exported, Source};
use crate::operations::import::import_with;
use crate::store::ParameterSetRow;
use crate::wire::export::{BetaChoice, ExportAnswer, ExportFormat};
use crate::wire::import::{ImportAnswer, ImportDigits, ImportFormat};
use crate::wire::parameter_set::{ParameterSetContent, ParameterSetStatus, Provenance};
use crate::wire::robot::{Robot, RobotBody};
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

/// Header with the error that remains when only this format's parameters are used, mm.
const REMAINING_ERROR: HeaderName = HeaderName::from_static("kincal-remaining-error-mm");

/// Query of an export.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ExportQuery {
    /// Format of the export.
    #[serde(default)]
    #[param(inline)]
    format: ExportFormat,
    /// Treatment of beta: `refit` for controllers without beta.
    #[serde(default)]
    #[param(inline)]
    beta: BetaChoice,
}

/// Query of a patch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PatchQuery {
    /// `urdf`.
    #[param(inline)]
    format: ExportFormat,
    /// The link at the end of the robot; default: the end of the chain with as many moving joints as the robot has links.
    tip: Option<String>,
}

/// Query of an import.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ImportQuery {
    /// Format of the body.
    #[param(inline)]
    format: ImportFormat,
    /// The robot's name.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// The link at the end of the robot, in a URDF with several.
    tip: Option<String>,
    /// `source` replaces angles of a URDF that are a rounded multiple of 90° by the exact multiple. `largest_difference_mm` is the
    /// resulting movement of the tip.
    #[param(inline)]
    digits: Option<ImportDigits>,
}

/// Exports the identified links in a format of other software or of a controller. The text is read back and compared to 1e-9 mm before it is sent. A
/// withdrawn set is not exported.
#[utoipa::path(
    get, path = "/v1/parameter-sets/{id}/export", tag = "parameter sets", operation_id = "exportParameterSet",
    params(("id" = String, Path, description = "The parameter set"), ExportQuery),
    responses((status = 200, description = "The text; json and yaml are the same document, ur_kinematics is the YAML file of Universal Robots' drivers", content(
        (ExportAnswer = "application/json"), (serde_json::Value = "application/yaml"), (String = "text/csv"), (String = "application/xml")
    ), headers(("Kincal-Remaining-Error-Mm" = String, description = "What is lost with beta=refit or format=mastering: mean and max"))))
)]
pub async fn get(
    Item { app, caller, id }: Item,
    Query(query): Query<ExportQuery>,
) -> Result<Response, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let rows = load_rows(&app, &permit, &caller, &id).await?;
    let ExportQuery { format, beta } = query;
    let export = move || rows.write_with(|source| export::export(source, format, beta));
    respond(&app, &row, permit.run(export).await?).await
}

/// Returns the URDF in the body with the joint origins of the identified robot. Nothing else changes.
#[utoipa::path(
    post, path = "/v1/parameter-sets/{id}/export", tag = "parameter sets", operation_id = "patchUrdf",
    params(("id" = String, Path, description = "The parameter set"), PatchQuery),
    request_body(description = "A URDF of the nominal robot, xacro expanded", content((String = "application/xml"))),
    responses((status = 200, description = "The same text with other origins", content((String = "application/xml"))))
)]
pub async fn patch_urdf(
    Item { app, caller, id }: Item,
    Query(query): Query<PatchQuery>,
    request: Request,
) -> Result<Response, Error> {
    let row = access::parameter_set(&app, &caller, &id).await?;
    if query.format != ExportFormat::Urdf {
        let detail = "only a URDF can be patched: format=urdf; else GET";
        return Err(Error::invalid_query(detail));
    }
    let bytes = whole_body(request, &app).await?;
    let permit = app.limits.compute_permit(caller.class).await?;
    let rows = load_rows(&app, &permit, &caller, &id).await?;
    let patch =
        move || rows.write_with(|source| export::patch_urdf(source, &bytes, query.tip.as_deref()));
    respond(&app, &row, permit.run(patch).await?).await
}

/// Converts a URDF or a table of Denavit-Hartenberg parameters to the body of `POST /v1/robots`. Nothing is stored.
#[utoipa::path(
    post, path = "/v1/robot-imports", tag = "robots", operation_id = "importRobot", params(ImportQuery),
    request_body(description = "The description", content((String = "application/xml"), (String = "text/csv"), (serde_json::Value = "application/json"))),
    responses((status = 200, description = "The robot, and the transformations that its links cannot represent", body = ImportAnswer))
)]
pub async fn import_robot(
    State(app): State<App>,
    caller: Caller,
    Query(query): Query<ImportQuery>,
    request: Request,
) -> Result<Json<ImportAnswer>, Error> {
    let bytes = whole_body(request, &app).await?;
    let answer = app.compute(caller.class, move || {
        let name = query.name.as_deref().unwrap_or("imported robot");
        let (format, digits) = (query.format, query.digits.unwrap_or_default());
        Ok(import_with(
            &bytes,
            format,
            digits,
            name,
            query.tip.as_deref(),
        )?)
    });
    Ok(Json(answer.await?))
}

/// Stored rows that an export needs.
struct ExportRows {
    row: ParameterSetRow,
    body: RobotBody,
    content: ParameterSetContent,
    provenance: Provenance,
}

impl ExportRows {
    fn write_with(
        &self,
        write: impl Fn(&Source<'_>) -> Result<Exported, export::Error>,
    ) -> Result<Exported, Error> {
        let robot = Robot::try_from(&self.body)?;
        let Self {
            row,
            body,
            content,
            provenance,
        } = self;
        write(&Source {
            id: &row.id,
            body,
            robot: &robot,
            content,
            provenance,
        })
        .map_err(|error| match error {
            export::Error::Invalid(invalid) => invalid.into(),
            error @ export::Error::ReadBack { .. } => Error::Internal(error.to_string()),
        })
    }
}

async fn load_rows(
    app: &App,
    permit: &ComputePermit,
    caller: &Caller,
    id: &str,
) -> Result<ExportRows, Error> {
    let row = access::parameter_set(app, caller, id).await?;
    if row.status == ParameterSetStatus::Withdrawn {
        let reason = row.withdraw_reason.as_deref().unwrap_or_default();
        let detail = format!(
            "the parameter set was withdrawn ({reason}), and no controller must get it: export the active set. Its numbers stay readable: GET \
             /v1/parameter-sets/{id}"
        );
        return Err(Error::conflict("parameter_set_withdrawn", detail));
    }
    let body = access::robot_of_set(app, caller, &row).await?;
    let content = parameter_sets::content(&row)?;
    let provenance = parameter_sets::provenance(app, permit, &row).await?;
    Ok(ExportRows {
        row,
        body,
        content,
        provenance,
    })
}

async fn respond(app: &App, row: &ParameterSetRow, exported: Exported) -> Result<Response, Error> {
    let Exported {
        content_type,
        extension,
        text,
        remaining,
    } = exported;
    let name = file_name::attachment(app, &row.robot_id, &row.job_id, &row.id, extension).await?;
    let mut response = (
        [
            (header::CONTENT_TYPE, HeaderValue::from_static(content_type)),
            (header::CONTENT_DISPOSITION, name),
        ],
        text,
    )
        .into_response();
    if let Some(remaining) = remaining {
        let lost = format!("mean={}, max={}", remaining.mean, remaining.max);
        let lost = HeaderValue::from_str(&lost).map_err(|e| Error::Internal(e.to_string()))?;
        response.headers_mut().insert(REMAINING_ERROR, lost);
    }
    Ok(response)
}
