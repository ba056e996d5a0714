//! References of a robot's instruments: scale bars and other lengths with a certificate.

use crate::calibration::reference::InstrumentScale;
use crate::http::auth::Caller;
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::Id;
use crate::http::list_query::{NewestListQuery, list_of_robot};
use crate::http::named_documents::DocumentAnswer;
use crate::http::{App, Error, access, named_documents};
use crate::operations::check_reference;
use crate::store::named_documents::NamedDocumentKind;
use crate::store::{self, NamedDocumentRow};
use crate::wire::Invalid;
use crate::wire::page::Page;
use crate::wire::reference::{PPM, ReferenceAnswer, ReferenceBody, SetReference};
use crate::wire::time::rfc3339;
use axum::Json;
use axum::extract::{Path, State};
use axum::response::Response;

/// Stores what an instrument measured of lengths with a certificate. Uploads that name the reference (`?reference=NAME`) rest on it: the report states the
/// scale of the instrument, warns if it is off (`instrument_scale`), and adds it to the tool's uncertainty.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/references", tag = "measurement sets", operation_id = "createReference",
    params(("robot_id" = String, Path, description = "The robot")), request_body = ReferenceBody,
    responses((status = 201, description = "The reference, stored", body = ReferenceAnswer, headers(("Location" = String, description = "Its path"))))
)]
pub async fn create(Id(robot_id): Id, submission: Submission) -> Result<Response, Error> {
    access::robot_in_use(&submission.app, &submission.caller, &robot_id).await?;
    let body: ReferenceBody = submission.json()?;
    check_reference(&body)?;
    let answer = |stored: &ReferenceAnswer| {
        let path = format!("/v1/robots/{robot_id}/references/{}", stored.id);
        stored_json(201, Some(path), stored)
    };
    named_documents::store(&robot_id, body.name(), &submission, &body, answer).await
}

list_of_robot! {
    /// A robot's references, newest first: of each name the newest version.
    list: "/v1/robots/{robot_id}/references" "measurement sets" "listReferences", NewestListQuery ReferenceAnswer, store::named_documents::list, NamedDocumentKind::Reference
}

/// A reference by its id, in any version.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/references/{id}", tag = "measurement sets", operation_id = "getReference",
    params(("robot_id" = String, Path, description = "The robot"), ("id" = String, Path, description = "The reference")),
    responses((status = 200, description = "The reference", body = ReferenceAnswer))
)]
pub async fn get(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, id)): Path<(String, String)>,
) -> Result<Json<ReferenceAnswer>, Error> {
    access::robot(&app, &caller, &robot_id).await?;
    let row = store::named_documents::get(&app.store, &id).await;
    let is_its = |row: &NamedDocumentRow| {
        row.robot_id == robot_id && row.kind == NamedDocumentKind::Reference.as_str()
    };
    match row {
        Ok(row) if is_its(&row) => Ok(Json(ReferenceAnswer::try_from(&row)?)),
        Ok(_) | Err(store::Error::NotFound) => Err(Error::NotFound("reference")),
        Err(error) => Err(error.into()),
    }
}

/// The reference that an upload names, in its newest version.
pub async fn named(
    app: &App,
    robot_id: &str,
    name: &str,
) -> Result<(SetReference, Option<InstrumentScale>), Error> {
    let row = named_documents::newest(app, robot_id, NamedDocumentKind::Reference, name).await;
    let row = row.map_err(|error| match error {
        Error::NotFound(_) => {
            let detail = format!(
                "the robot has no reference {name:?}: store its lengths first (POST …/references, kincal references add), or leave it out"
            );
            Invalid::at("/reference", "unknown_reference", detail).into()
        }
        other => other,
    })?;
    let body: ReferenceBody = serde_json::from_str(&row.content_json)?;
    let reference = SetReference {
        id: row.id,
        name: row.name,
    };
    Ok((reference, body.scale()))
}

impl TryFrom<&NamedDocumentRow> for ReferenceAnswer {
    type Error = Error;

    fn try_from(row: &NamedDocumentRow) -> Result<Self, Error> {
        let body: ReferenceBody = serde_json::from_str(&row.content_json)?;
        let scale = body.scale();
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            name: row.name.clone(),
            version: row.version,
            scale_error_ppm: scale.map_or(0.0, |scale| PPM * scale.error),
            scale_std_ppm: scale.map_or(0.0, |scale| PPM * scale.std),
            is_off: scale.is_some_and(|scale| scale.is_off()),
            items: body.items,
            instrument: body.instrument,
            created_at: rfc3339(row.created_at_ms),
        })
    }
}

impl DocumentAnswer for ReferenceAnswer {
    const KIND: NamedDocumentKind = NamedDocumentKind::Reference;
}
