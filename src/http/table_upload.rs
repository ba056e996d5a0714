//! Media types of an upload, and the mapping of columns that its query states.

use crate::http::creation::Submission;
use crate::http::{App, Error, named_documents};
use crate::store::named_documents::NamedDocumentKind;
use crate::wire::columns::ColumnsBody;
use crate::wire::multipart::is_multipart;
use crate::wire::{Invalid, json, workbook};

/// First bytes of a zip archive; xlsx and ods are such archives.
const ZIP: &[u8] = b"PK\x03\x04";
/// First bytes of a workbook in the old binary format (xls).
const OLD_WORKBOOK: &[u8] = b"\xD0\xCF\x11\xE0";
/// Media types that an upload may have, for error messages.
const EXPECTED: &str = "text/csv, application/json, a workbook (xlsx, ods) or multipart/form-data with two files (save other workbooks as CSV first)";

/// Refuses other media types than those of tables, JSON and forms, before the body is parsed.
pub fn refuse_other_types(submission: &Submission) -> Result<(), Error> {
    let media_type = submission.media_type.as_str();
    let is_table = ["text/csv", workbook::XLSX, workbook::ODS].contains(&media_type);
    // browsers and clients that do not know a workbook send it as application/octet-stream
    let is_workbook = workbook::workbook(&submission.body).is_some();
    let is_known =
        is_table || is_workbook || media_type == "application/json" || is_multipart(media_type);
    let is_archive = submission.body.starts_with(ZIP) && !is_table && !is_workbook;
    if is_archive || submission.body.starts_with(OLD_WORKBOOK) {
        return Err(not_a_workbook());
    }
    if is_known {
        Ok(())
    } else {
        Err(submission.unsupported(EXPECTED))
    }
}

fn not_a_workbook() -> Error {
    Error::UnsupportedMediaType {
        found: "an archive or an old workbook".into(),
        expected: EXPECTED,
    }
}

/// The content type that is stored with a table. A workbook is recognised by its bytes, whatever type it was sent with.
pub fn table_type(bytes: &[u8], sent: String) -> Result<String, Error> {
    if is_multipart(&sent) {
        return Ok(sent);
    }
    match workbook::workbook(bytes) {
        Some(kind) => Ok(kind.media_type().into()),
        None if bytes.starts_with(ZIP) => Err(not_a_workbook()),
        None if sent == workbook::XLSX || sent == workbook::ODS => Ok("text/csv".into()),
        None => Ok(sent),
    }
}

/// The mapping of columns in a query: JSON, or the name of one of the robot's mappings.
pub async fn stated_columns(
    app: &App,
    robot_id: &str,
    stated: Option<&str>,
) -> Result<ColumnsBody, Error> {
    let Some(stated) = stated.map(str::trim).filter(|text| !text.is_empty()) else {
        return Ok(ColumnsBody::default());
    };
    if stated.starts_with('{') {
        return Ok(ColumnsBody::parse(stated.as_bytes())?);
    }
    match named_documents::newest(app, robot_id, NamedDocumentKind::Columns, stated).await {
        Ok(row) => Ok(json::parse(row.content_json.as_bytes())?),
        Err(Error::NotFound(_)) => {
            let detail = format!(
                "the robot has no column mapping called {stated:?}: keep one (PUT /v1/robots/{{robot_id}}/columns/{{name}}; kincal columns keep ROBOT NAME), or give it in JSON"
            );
            Err(Invalid::at("/columns", "unknown_mapping", detail).into())
        }
        Err(error) => Err(error),
    }
}
