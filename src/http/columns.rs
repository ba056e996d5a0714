//! Named mappings of columns, and the preview of a file before it is uploaded.

use crate::http::auth::Caller;
use crate::http::creation::Submission;
use crate::http::extract::{Id, Query};
use crate::http::list_query::{NewestListQuery, list_of_robot};
use crate::http::named_documents::DocumentAnswer;
use crate::http::table_upload::{refuse_other_types, stated_columns, table_type};
use crate::http::{App, Error, access, named_documents};
use crate::operations::preview_table;
use crate::store::named_documents::NamedDocumentKind;
use crate::store::{self, NamedDocumentRow};
use crate::wire::columns::{ColumnMappingAnswer, ColumnsBody};
use crate::wire::issue::Checker;
use crate::wire::measurement::Decimal;
use crate::wire::multipart::{FileBytes, UploadForm};
use crate::wire::page::Page;
use crate::wire::robot::{MAX_NAME, Robot};
use crate::wire::table_preview::PreviewAnswer;
use crate::wire::time::rfc3339;
use axum::Json;
use axum::extract::{Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;

/// Query of a preview.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PreviewQuery {
    /// As in the upload.
    #[param(inline)]
    decimal: Option<Decimal>,
    /// As in the upload.
    columns: Option<String>,
}

/// Previews a table, or two files, and stores nothing: how they are understood, their first rows, what is missing, and a proposed mapping.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/measurement-sets/preview", tag = "measurement sets", operation_id = "previewMeasurementSet",
    params(("robot_id" = String, Path, description = "The robot"), PreviewQuery),
    request_body(
        description = "As in the upload; no JSON",
        content(
            (String = "text/csv"),
            (FileBytes = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"),
            (FileBytes = "application/vnd.oasis.opendocument.spreadsheet"),
            (UploadForm = "multipart/form-data")
        )
    ),
    responses((status = 200, description = "How the files are understood", body = PreviewAnswer))
)]
pub async fn preview(
    Id(robot_id): Id,
    Query(query): Query<PreviewQuery>,
    submission: Submission,
) -> Result<Json<PreviewAnswer>, Error> {
    let app = &submission.app;
    let robot = access::robot(app, &submission.caller, &robot_id).await?;
    refuse_other_types(&submission)?;
    if submission.media_type == "application/json" {
        return Err(
            submission.unsupported("text/csv, a workbook (xlsx, ods) or multipart/form-data")
        );
    }
    let columns = stated_columns(app, &robot_id, query.columns.as_deref()).await?;
    let n_joints = Robot::try_from(&access::robot_body(&robot)?)?.links.len();
    let look = move || {
        let content_type = table_type(&submission.body, submission.content_type.clone())?;
        let answer = preview_table(
            &content_type,
            &submission.body,
            &columns,
            query.decimal,
            n_joints,
        )?;
        Ok::<_, Error>(answer)
    };
    Ok(Json(app.compute(submission.caller.class, look).await?))
}

/// Checks the name of a mapping. Does not query the database.
fn check_name(name: &str) -> Result<(), Error> {
    let mut checker = Checker::default();
    checker.text("/name", name, MAX_NAME);
    if name.starts_with('{') || name.trim() != name {
        checker.add(
            "/name",
            "invalid_name",
            "a name does not begin with { and has no space around it",
        );
    }
    Ok(checker.finish("invalid_name")?)
}

list_of_robot! {
    /// A robot's mappings of columns, newest first.
    list: "/v1/robots/{robot_id}/columns" "measurement sets" "listColumns", NewestListQuery ColumnMappingAnswer, store::named_documents::list, NamedDocumentKind::Columns
}

/// A mapping of columns by its name.
#[utoipa::path(
    get, path = "/v1/robots/{robot_id}/columns/{name}", tag = "measurement sets", operation_id = "getColumns",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The mapping's name")),
    responses((status = 200, description = "The mapping", body = ColumnMappingAnswer))
)]
pub async fn get(
    State(app): State<App>,
    caller: Caller,
    Path((robot_id, name)): Path<(String, String)>,
) -> Result<Json<ColumnMappingAnswer>, Error> {
    check_name(&name)?;
    named_documents::get(&app, &caller, &robot_id, &name).await
}

/// Stores a mapping of columns under a name. It replaces an earlier one of that name; sets that were uploaded with the earlier one stay as they are.
#[utoipa::path(
    put, path = "/v1/robots/{robot_id}/columns/{name}", tag = "measurement sets", operation_id = "putColumns",
    params(("robot_id" = String, Path, description = "The robot"), ("name" = String, Path, description = "The mapping's name")),
    request_body = ColumnsBody,
    responses((status = 200, description = "The mapping, stored", body = ColumnMappingAnswer))
)]
pub async fn put(
    Path((robot_id, name)): Path<(String, String)>,
    submission: Submission,
) -> Result<Response, Error> {
    check_name(&name)?;
    access::robot_in_use(&submission.app, &submission.caller, &robot_id).await?;
    let columns: ColumnsBody = submission.json()?;
    columns.check()?;
    named_documents::put::<ColumnMappingAnswer>(&robot_id, &name, &submission, columns).await
}

impl DocumentAnswer for ColumnMappingAnswer {
    const KIND: NamedDocumentKind = NamedDocumentKind::Columns;
}

impl TryFrom<&NamedDocumentRow> for ColumnMappingAnswer {
    type Error = Error;

    fn try_from(row: &NamedDocumentRow) -> Result<Self, Error> {
        Ok(Self {
            name: row.name.clone(),
            columns: serde_json::from_str(&row.content_json)?,
            created_at: rfc3339(row.created_at_ms),
        })
    }
}
