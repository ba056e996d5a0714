//! Measurement sets: uploads, stored byte for byte.

use crate::calibration::reference::ScaleAtReach;
use crate::calibration::{instrument_scale, upload_checks};
use crate::http::creation::{Submission, stored_json};
use crate::http::extract::{Id, Item, Query};
use crate::http::limits::ComputePermit;
use crate::http::list_query::{NamedListQuery, list_of_robot};
use crate::http::table_upload::{refuse_other_types, stated_columns, table_type};
use crate::http::upload_check::{self, Misfit};
use crate::http::{App, Error, access, references};
use crate::operations::rotation_convention::with_best_convention;
use crate::release::{AcceptedMisfit, accept_rotations, unread_labels};
use crate::store::{MeasurementSetRow, NewMeasurementSet, Tx, measurement_sets};
use crate::wire::columns::ColumnsBody;
use crate::wire::content_type::{
    DECIMAL_COMMA, declared_rotation, rotation_convention, with_rotation,
};
use crate::wire::instrument::InstrumentBody;
use crate::wire::issue::Checker;
use crate::wire::measurement::{
    self, DEFAULT_FRAME, Decimal, Frame, MeasurementSet, MeasurementSetBody, SetSummary, Warning,
    from_upload, points_csv,
};
use crate::wire::multipart::{FileBytes, UploadForm};
use crate::wire::page::Page;
use crate::wire::points_csv::PointsFormat;
use crate::wire::robot::{MAX_NAME, Robot, RobotBody};
use crate::wire::session_record::SessionRecord;
use crate::wire::suspicion::Insist;
use crate::wire::time::rfc3339;
use crate::wire::understood::Reading;
use crate::wire::{Invalid, canonical, json};
use axum::Json;
use axum::body::Bytes;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

/// Query of an upload.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct UploadQuery {
    /// The frame of every position; `base` if neither the query nor a JSON body states it.
    #[param(inline)]
    frame: Option<Frame>,
    /// Name of the set; a name in a JSON body takes precedence.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// Number format of a CSV file: `comma` for 12,5 with columns separated by semicolons. Never guessed.
    #[param(inline)]
    decimal: Option<Decimal>,
    /// Convention of `rx_deg ry_deg rz_deg`: `intrinsic_xyz`, `extrinsic_xyz`, `intrinsic_zyx`, …, or `rotation_vector`. Never guessed.
    #[param(max_length = 40, example = "intrinsic_xyz")]
    rotation: Option<String>,
    /// Serial number of the robot that was measured; an upload for another robot is refused.
    #[param(min_length = 1, max_length = 200)]
    serial_number: Option<String>,
    /// Stores the set although the check refuses it with this code. The code is stored too, and the set cannot lead to a release.
    #[param(inline)]
    insist: Option<Insist>,
    /// Standard uncertainty of a length that an instrument at the frame's origin measures, mm. Needs `angle_std_deg` and the frame `instrument`.
    /// A JSON body may state the instrument instead (`instrument`).
    #[param(minimum = 1e-6, maximum = 1000, example = 0.01)]
    range_std_mm: Option<f64>,
    /// Part of that uncertainty that grows with the length, mm per m; default 0.
    #[param(minimum = 0, maximum = 1000, example = 0.0004)]
    range_std_mm_per_m: Option<f64>,
    /// Standard uncertainty of each of the instrument's angles, degrees.
    #[param(exclusive_minimum = 0, maximum = 90, example = 0.0002)]
    angle_std_deg: Option<f64>,
    /// True if the instrument was levelled: gravity is −z of the measuring frame. Needs the frame `instrument`.
    instrument_levelled: Option<bool>,
    /// Name of a reference of the robot that the instrument measured (`POST …/references`); its newest version counts.
    #[param(min_length = 1, max_length = 200)]
    reference: Option<String>,
    /// True if the poses are those of a fixed board as a camera on the arm sees it: they are inverted, and the measuring frame is the board's. Needs the
    /// frame `instrument`.
    inverse_poses: Option<bool>,
    /// When the session was measured: RFC 3339. It is shown in place of the time of the upload. Default: the earliest `measured_at` of the points.
    #[param(example = "2026-03-01T08:15:30Z")]
    measured_at: Option<String>,
    /// Instrument, for quality records: maker, model, serial number.
    #[param(min_length = 1, max_length = 200)]
    instrument_name: Option<String>,
    /// Certificate of the instrument, for quality records: number, valid until.
    #[param(min_length = 1, max_length = 200)]
    instrument_certificate: Option<String>,
    /// Who measured, for quality records.
    #[param(min_length = 1, max_length = 200)]
    operator: Option<String>,
    /// Mapping of the columns of a table: in JSON, or the name of a mapping that the robot has (`PUT …/columns/{name}`).
    columns: Option<String>,
}

impl UploadQuery {
    fn record(&self) -> SessionRecord {
        SessionRecord {
            measured_at: self.measured_at.clone(),
            measured_at_of_points: false,
            instrument_name: self.instrument_name.clone(),
            instrument_certificate: self.instrument_certificate.clone(),
            operator: self.operator.clone(),
        }
    }
}

/// A parsed upload, with the hash of its bytes.
struct ParsedUpload {
    sha256: String,
    frame: Frame,
    name: Option<String>,
    n_points: usize,
    n_configurations: usize,
    n_targets: usize,
    content_type: String,
    reading: Option<Reading>,
    warnings: Vec<Warning>,
    insisted_on: Option<Insist>,
    misfit: Option<Misfit>,
}

impl ParsedUpload {
    /// Adds the warning and the override of an upload that does not fit the robot but was accepted.
    fn accept(&mut self, accepted: AcceptedMisfit) {
        self.warnings.push(accepted.warning);
        self.insisted_on = accepted.insisted_on.or(self.insisted_on);
    }
}

/// Uploads a measurement set, as CSV (a header row with units) or JSON.
#[utoipa::path(
    post, path = "/v1/robots/{robot_id}/measurement-sets", tag = "measurement sets", operation_id = "createMeasurementSet",
    params(("robot_id" = String, Path, description = "The robot"), UploadQuery),
    request_body(
        description = "A table: `q1_deg … qn_deg` or `q1_rad …`, `x_mm y_mm z_mm` or `x_m …`, or columns that `columns` maps; of poses also `quat_w quat_x quat_y quat_z`, or `rx_deg ry_deg rz_deg` with `rotation`; optional `configuration`, `target`, `subset`, `measured_at`, `std_mm` or `std_x_mm std_y_mm std_z_mm` or `cov_xx_mm2 cov_xy_mm2 cov_xz_mm2 cov_yy_mm2 cov_yz_mm2 cov_zz_mm2`, `std_rotation_deg` or `std_rx_deg std_ry_deg std_rz_deg`, `kind`, `station`, `session`, `sequence`, `temperature_c`. A form has the parts `robot` and `instrument` (two files that are joined), or `table`, and perhaps `columns`",
        content(
            (String = "text/csv"),
            (MeasurementSetBody = "application/json"),
            (FileBytes = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"),
            (FileBytes = "application/vnd.oasis.opendocument.spreadsheet"),
            (UploadForm = "multipart/form-data")
        )
    ),
    responses((status = 201, description = "The stored set, as it was parsed", body = SetSummary, headers(("Location" = String, description = "Its path"))))
)]
pub async fn create(
    Id(robot_id): Id,
    Query(query): Query<UploadQuery>,
    submission: Submission,
) -> Result<Response, Error> {
    let app = &submission.app;
    let robot = access::robot_in_use(app, &submission.caller, &robot_id).await?;
    refuse_other_types(&submission)?;
    let (robot, bytes) = (access::robot_body(&robot)?, submission.body.clone());
    let mut content_type = content_type(&submission, query.decimal);
    if let Some(name) = &query.rotation {
        let convention = rotation_convention(name)?;
        if is_json(&content_type) {
            return Err(rotation_of_json().into());
        }
        content_type = with_rotation(&content_type, convention);
    }
    let columns = stated_columns(app, &robot_id, query.columns.as_deref()).await?;
    let insist = query.insist;
    let reference = match query.reference.as_deref() {
        Some(name) => Some(references::named(app, &robot_id, name).await?),
        None => None,
    };
    let links = Robot::try_from(&robot)?.links;
    let record = query.record().checked()?;
    let serial_number = query.serial_number.clone();
    let mut upload = app
        .compute(submission.caller.class, move || {
            parse_upload(&robot, &bytes, content_type, &columns, query, record)
        })
        .await?;
    if let Some((reference, scale)) = reference {
        upload.reading.get_or_insert_default().reference = Some(reference);
        let warning = scale.and_then(|scale| instrument_scale(ScaleAtReach::new(scale, &links)));
        upload.warnings.extend(warning.as_ref().map(Warning::from));
    }
    if let Some(misfit) = upload.misfit.take() {
        let unread = upload.reading.as_ref().and_then(unread_labels);
        let caller = &submission.caller;
        let accepted =
            upload_check::diagnose(app, caller, &robot_id, misfit, insist, unread).await?;
        upload.accept(accepted);
    }
    // A key that is limited to some robots must not learn about others.
    if submission.caller.robots.is_none()
        && measurement_sets::n_other_robots(&app.store, &robot_id, &upload.sha256).await? > 0
    {
        upload.warnings.push(same_file_elsewhere());
    }
    if let Some(known) = measurement_sets::same_file(&app.store, &robot_id, &upload.sha256).await? {
        upload.warnings.push(same_file_again(&known));
    }
    let reading = upload.reading.as_ref();
    let new = NewMeasurementSet {
        robot_id,
        name: upload.name,
        frame: upload.frame,
        content_type: upload.content_type,
        body: submission.body.to_vec(),
        sha256: upload.sha256,
        n_points: upload.n_points as i64,
        n_configurations: upload.n_configurations as i64,
        n_targets: upload.n_targets as i64,
        warnings_json: serde_json::to_string(&upload.warnings)?,
        uploaded_by: Some(submission.caller.holder.clone()),
        serial_number,
        insisted_on: upload.insisted_on.map(|code| code.as_str().to_owned()),
        reading_json: reading.map(serde_json::to_string).transpose()?,
    };
    let effect = async |tx: &mut Tx| {
        let row = measurement_sets::insert(tx, &new).await?;
        stored_json(
            201,
            Some(format!("/v1/measurement-sets/{}", row.id)),
            &SetSummary::try_from(&row)?,
        )
    };
    submission.create(effect).await
}

/// Content type that is stored with the bytes, with the decimal mark that the query declared.
fn content_type(submission: &Submission, decimal: Option<Decimal>) -> String {
    match submission.media_type.as_str() {
        "text/csv" if decimal.is_some() => declared_csv(decimal),
        _ => submission.content_type.clone(),
    }
}

fn declared_csv(decimal: Option<Decimal>) -> String {
    match decimal {
        Some(Decimal::Comma) => format!("text/csv; {DECIMAL_COMMA}"),
        _ => "text/csv".into(),
    }
}

/// The error for a rotation convention with JSON: poses in JSON have quaternions.
fn rotation_of_json() -> Invalid {
    let detail =
        "points in JSON have a quaternion [w, x, y, z] and need no convention: leave rotation out";
    Invalid::at("/rotation", "rotation_not_needed", detail)
}

fn is_json(content_type: &str) -> bool {
    content_type
        .to_ascii_lowercase()
        .starts_with("application/json")
}

fn parse_upload(
    body: &RobotBody,
    bytes: &Bytes,
    content_type: String,
    columns: &ColumnsBody,
    query: UploadQuery,
    record: Option<SessionRecord>,
) -> Result<ParsedUpload, Error> {
    check_serial_number(body, query.serial_number.as_deref())?;
    let robot = Robot::try_from(body)?;
    let n_joints = robot.links.len();
    let instrument = InstrumentBody::from_parameters(
        query.range_std_mm,
        query.range_std_mm_per_m,
        query.angle_std_deg,
        query.instrument_levelled,
    );
    let (stated_frame, name, set, reading, content_type) = if is_json(&content_type) {
        let upload: MeasurementSetBody = json::parse(bytes)?;
        let frame = upload.resolve_frame(query.frame)?;
        let set = upload.measurement_set(frame, instrument, n_joints)?;
        let reading = upload.reading(instrument);
        let name = upload.name.or(query.name);
        (frame, name, set, reading, content_type)
    } else {
        let content_type = table_type(bytes, content_type)?;
        let upload = measurement::Upload {
            content_type: &content_type,
            bytes,
            columns,
            decimal: query.decimal,
            rotation: None,
            frame: query.frame.unwrap_or(DEFAULT_FRAME),
            instrument,
        };
        let (set, reading) = measurement::from_file(&upload, n_joints)
            .map_err(|refusal| with_best_convention(refusal, &robot, &upload))?;
        (query.frame, query.name, set, reading, content_type)
    };
    let (mut set, mut reading) = (set, reading);
    if query.inverse_poses == Some(true) {
        set = measurement::inverted(set)?;
        reading.get_or_insert_default().inverse_poses = true;
    }
    if let Some(record) = SessionRecord::for_set(record, &set) {
        reading.get_or_insert_default().record = Some(record);
    }
    let mut checker = Checker::default();
    name.iter()
        .for_each(|name| checker.text("/name", name, MAX_NAME));
    checker.finish("invalid_name")?;
    let found = upload_checks::warnings(&robot, &set);
    let mut warnings: Vec<Warning> = found
        .iter()
        .map(|warning| {
            let mut warning = Warning::from(warning);
            warning.rows.truncate(MAX_WARNED_ROWS);
            warning.with_point_names(|row| set.points.get(row)?.name.as_deref())
        })
        .collect();
    if stated_frame.is_none() {
        warnings.push(frame_assumed());
    }
    let mut parsed = ParsedUpload {
        sha256: canonical::sha256_hex(bytes),
        frame: stated_frame.unwrap_or(DEFAULT_FRAME),
        name,
        n_points: set.points.len(),
        n_configurations: set.configurations().len(),
        n_targets: measurement::n_targets(&set),
        content_type,
        reading,
        warnings,
        insisted_on: None,
        misfit: None,
    };
    if let Some(accepted) = accept_rotations(&robot, &set, query.insist)? {
        parsed.accept(accepted);
    }
    parsed.misfit = upload_check::check_fit(body, set)?;
    Ok(parsed)
}

/// Maximum number of rows that one warning about an upload names.
const MAX_WARNED_ROWS: usize = 20;

/// Warning for an upload that does not declare its frame.
fn frame_assumed() -> Warning {
    let detail = "the upload does not state the frame of its positions; the robot's base frame is assumed. State the frame: base, or instrument \
                  if the base's pose and the targets are unknown";
    Warning::new("frame_assumed", detail)
}

fn same_file_elsewhere() -> Warning {
    let detail = "the same file was uploaded to another robot, too: was it measured on this one? State serial_number with the upload, and a file of another \
                  robot is refused";
    Warning::new("same_file_elsewhere", detail)
}

fn same_file_again(known: &MeasurementSetRow) -> Warning {
    let detail = format!(
        "the same file was uploaded to this robot before, as {:?}: its points say nothing new, and count as the same session",
        known.name.as_ref().unwrap_or(&known.id)
    );
    Warning::new("same_file_again", detail)
}

/// Refuses an upload that names another serial number.
fn check_serial_number(robot: &RobotBody, stated: Option<&str>) -> Result<(), Error> {
    let Some(stated) = stated else { return Ok(()) };
    let mut checker = Checker::default();
    checker.text("/serial_number", stated, MAX_NAME);
    checker.finish("invalid_serial_number")?;
    match &robot.serial_number {
        Some(own) if own != stated => {
            let detail = format!(
                "the upload says serial number {stated:?}, this robot has {own:?}: upload it to the robot that was measured"
            );
            Err(Invalid::at("/serial_number", "robot_mismatch", detail).into())
        }
        _ => Ok(()),
    }
}

list_of_robot! {
    /// A robot's measurement sets.
    list: "/v1/robots/{robot_id}/measurement-sets" "measurement sets" "listMeasurementSets", NamedListQuery SetSummary, measurement_sets::search
}

/// A measurement set.
#[utoipa::path(
    get, path = "/v1/measurement-sets/{id}", tag = "measurement sets", operation_id = "getMeasurementSet",
    params(("id" = String, Path, description = "The set")),
    responses((status = 200, description = "The summary", body = SetSummary))
)]
pub async fn get(Item { app, caller, id }: Item) -> Result<Json<SetSummary>, Error> {
    let row = access::measurement_set(&app, &caller, &id).await?;
    Ok(Json((&row).try_into()?))
}

/// Query of a set's points.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PointsQuery {
    /// `csv` for the points as they were read, whatever files they were uploaded in: one row each, with the name and the line that the point has in its
    /// file. Default: the uploaded bytes.
    #[param(inline)]
    format: Option<PointsFormat>,
}

/// The uploaded bytes, in their own content type; or the points of the upload as a table.
#[utoipa::path(
    get, path = "/v1/measurement-sets/{id}/points", tag = "measurement sets", operation_id = "getMeasurementSetPoints",
    params(("id" = String, Path, description = "The set"), PointsQuery),
    responses((status = 200, description = "What was uploaded, byte for byte; with format=csv a table", content((String = "text/csv"), (MeasurementSetBody = "application/json"), (FileBytes = "multipart/form-data"))))
)]
pub async fn points(
    Item { app, caller, id }: Item,
    Query(query): Query<PointsQuery>,
) -> Result<Response, Error> {
    let permit = app.limits.compute_permit(caller.class).await?;
    let row = access::measurement_set(&app, &caller, &id).await?;
    let body = measurement_sets::body(&app.store, &id).await?;
    if query.format.is_none() {
        return Ok(([(header::CONTENT_TYPE, row.content_type)], body).into_response());
    }
    let robot = access::robot(&app, &caller, &row.robot_id).await?;
    let n_joints = access::robot_body(&robot)?.links.len();
    let table = move || {
        let reading = row.reading_json.as_deref();
        points_csv(&row.content_type, reading, &body, row.frame, n_joints).map_err(Error::Invalid)
    };
    let table = permit.run(table).await?;
    Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], table).into_response())
}

impl TryFrom<&MeasurementSetRow> for SetSummary {
    type Error = Error;

    fn try_from(row: &MeasurementSetRow) -> Result<Self, Error> {
        let reading = row
            .reading_json
            .as_deref()
            .map(serde_json::from_str::<Reading>);
        let reading = reading.transpose()?.unwrap_or_default();
        Ok(Self {
            id: row.id.clone(),
            robot_id: row.robot_id.clone(),
            name: row.name.clone(),
            frame: row.frame,
            n_points: row.n_points.unsigned_abs() as usize,
            n_configurations: row.n_configurations.unsigned_abs() as usize,
            n_targets: row.n_targets.unsigned_abs() as usize,
            sha256: row.sha256.clone(),
            created_at: rfc3339(row.created_at_ms),
            warnings: serde_json::from_str(&row.warnings_json)?,
            insisted_on: row.insisted_on.as_deref().and_then(Insist::parse),
            understood: reading.understood,
            joined: reading.joined,
            instrument: reading.instrument,
            reference: reading.reference,
            record: reading.record,
            serial_number: row.serial_number.clone(),
            rotation: declared_rotation(&row.content_type).map(|found| found.to_string()),
            inverse_poses: reading.inverse_poses,
            archived_at: row.archived_at_ms.map(rfc3339),
        })
    }
}

/// The points of a stored set of a robot with `n_joints` joints.
pub async fn points_of(
    app: &App,
    permit: &ComputePermit,
    set: MeasurementSetRow,
    n_joints: usize,
) -> Result<MeasurementSet, Error> {
    let bytes = measurement_sets::body(&app.store, &set.id).await?;
    let parse = move || {
        let reading = set.reading_json.as_deref();
        from_upload(&set.content_type, reading, &bytes, set.frame, n_joints).map_err(Error::Invalid)
    };
    permit.run(parse).await
}
