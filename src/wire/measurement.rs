//! Measurement sets: parsing of CSV and JSON, and their summary.

use crate::measurement;
use crate::measurement::RotationConvention;
pub use crate::measurement::csv::MAX_TARGETS;
pub use crate::measurement::sessions::joined;
pub use crate::measurement::set::n_shared_points;
use crate::measurement::table::own_form;
pub use crate::measurement::{Decimal, Frame, MeasurementSet, Subset};
use crate::wire::columns::ColumnsBody;
use crate::wire::content_type::{declared_decimal, declared_rotation};
use crate::wire::instrument::{self, InstrumentBody};
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::point::TimeCheck;
pub use crate::wire::point::{MAX_JOINT_VALUE_DEG, PointBody};
use crate::wire::points_csv;
use crate::wire::reference::SetReference;
use crate::wire::robot::MAX_NAME;
use crate::wire::session_record::SessionRecord;
use crate::wire::suspicion::Insist;
use crate::wire::table_upload::{self, Files, UploadOptions};
use crate::wire::time::is_rfc3339;
use crate::wire::understood::{JoinedFiles, Reading, UnderstoodBody};
pub use crate::wire::warning::Warning;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// Maximum number of points of one set. The largest public data sets have less than a thousand points.
pub const MAX_POINTS: usize = measurement::csv::MAX_ROWS;
/// Maximum size of an upload, bytes: 100,000 rows of about 300 characters.
pub const MAX_UPLOAD_BYTES: usize = 32 * 1024 * 1024;

/// Frame of an upload that does not declare a frame. The command line has the same default.
pub const DEFAULT_FRAME: Frame = Frame::Base;

/// A measurement set in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasurementSetBody {
    /// The frame of all positions. It may be given in the query instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// Its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// The instrument that measured all points, for frame `instrument`. It states the noise, so the points must not state their own. It may be given
    /// in the query instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument: Option<InstrumentBody>,
    /// The points, in measuring order.
    #[serde(deserialize_with = "json::at_most::<_, _, MAX_POINTS>")]
    #[schema(min_items = 1, max_items = 100000)]
    pub points: Vec<PointBody>,
}

/// Summary of a stored set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SetSummary {
    /// Opaque identifier.
    pub id: String,
    /// The robot that was measured.
    pub robot_id: String,
    /// Its name.
    #[schema(required)]
    pub name: Option<String>,
    /// The frame of every position.
    pub frame: Frame,
    /// Number of points.
    pub n_points: usize,
    /// Number of distinct arm configurations.
    pub n_configurations: usize,
    /// Number of reflectors.
    pub n_targets: usize,
    /// SHA-256 of the uploaded bytes, lower-case hexadecimal.
    pub sha256: String,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// Code of the suspicion that the uploader overrode with `insist`. Parameters that depend on such a set cannot be released.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub insisted_on: Option<Insist>,
    /// How the table was interpreted; absent for JSON and for older sets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understood: Option<UnderstoodBody>,
    /// How two files were interpreted and joined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joined: Option<JoinedFiles>,
    /// The instrument that measured all points, with its noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instrument: Option<InstrumentBody>,
    /// The reference that the instrument measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<SetReference>,
    /// When, by whom and with what the session was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record: Option<SessionRecord>,
    /// Serial number of the measured robot, as the uploader stated it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// Convention by which the rotations of the table were read, if one was stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<String>,
    /// True if the poses were inverted, as the uploader asked.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub inverse_poses: bool,
    /// When it was archived: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
}

/// A file of measurements, with the information that the caller gives about it.
#[derive(Clone, Copy, Debug)]
pub struct Upload<'a> {
    /// Its content type: JSON or a form with several files. Any other content type is read as a table.
    pub content_type: &'a str,
    /// Its bytes.
    pub bytes: &'a [u8],
    /// The column mapping that the caller gives.
    pub columns: &'a ColumnsBody,
    /// The decimal mark, if the caller gives it separately from the content type.
    pub decimal: Option<Decimal>,
    /// The rotation convention of poses, if the caller gives it separately from the content type.
    pub rotation: Option<RotationConvention>,
    /// The frame of every position.
    pub frame: Frame,
    /// The instrument, if the caller gives it separately from the file.
    pub instrument: Option<InstrumentBody>,
}

/// Parses sweeps, or any other table, without further information from the caller. The decimal mark is detected.
pub fn from_table(bytes: &[u8], frame: Frame, n_joints: usize) -> Result<MeasurementSet, Invalid> {
    let upload = Upload {
        content_type: "text/csv",
        bytes,
        columns: &ColumnsBody::default(),
        decimal: None,
        rotation: None,
        frame,
        instrument: None,
    };
    Ok(from_file(&upload, n_joints)?.0)
}

/// Parses a new file. Also returns how a table was interpreted.
pub fn from_file(
    upload: &Upload,
    n_joints: usize,
) -> Result<(MeasurementSet, Option<Reading>), Invalid> {
    if is_json(upload.content_type) {
        let body = json_body(upload.bytes)?;
        let times = JsonReading {
            is_time: is_rfc3339,
            instrument: upload.instrument,
        };
        let set = body.set_as(Some(upload.frame), n_joints, &times)?;
        return Ok((set, body.reading(upload.instrument)));
    }
    let files = Files::new(upload.content_type, upload.bytes)?;
    let columns = match &files.columns {
        None => upload.columns,
        Some(columns) if upload.columns.0.is_empty() => columns,
        Some(_) => {
            return Err(Invalid::at(
                "/columns",
                "invalid_columns",
                "the columns are mapped twice, in the form and beside it: leave one mapping out",
            ));
        }
    };
    let options = UploadOptions {
        columns,
        decimal: upload
            .decimal
            .or_else(|| declared_decimal(upload.content_type)),
        rotation: upload
            .rotation
            .or_else(|| declared_rotation(upload.content_type)),
        frame: upload.frame,
        n_joints,
        is_time: is_rfc3339,
    };
    let (mut set, mut reading) = table_upload::read(&files, &options)?;
    if let Some(stated) = instrument::resolve(None, upload.instrument)? {
        stated.apply_to(&mut set)?;
        reading.instrument = Some(stated.instrument);
    }
    Ok((set, Some(reading)))
}

/// The set with its poses inverted, for `inverse_poses` of an upload.
///
/// # Errors
/// [`Invalid`] for positions without rotations, and for poses in the base frame: inverted poses are those of a fixed board, which is no
/// robot base.
pub fn inverted(set: MeasurementSet) -> Result<MeasurementSet, Invalid> {
    if !set.has_poses() {
        let detail =
            "the set has positions alone, and only poses can be inverted: leave inverse_poses out";
        return Err(Invalid::at("/inverse_poses", "no_poses", detail));
    }
    if set.frame != Frame::Instrument {
        let detail = "inverted poses are in the frame of the board that the camera sees, which is no robot base: say frame=instrument";
        return Err(Invalid::at("/frame", "inverse_poses_in_base_frame", detail));
    }
    Ok(set.with_inverse_poses())
}

/// Parses a stored upload. `reading_json` says how the upload was interpreted when it was new; JSON and older uploads may have none.
///
/// # Errors
/// [`Invalid`]. This does not happen for bytes that were accepted once.
pub fn from_upload(
    content_type: &str,
    reading_json: Option<&str>,
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
) -> Result<MeasurementSet, Invalid> {
    let reading = stored_reading(reading_json)?;
    let set = parse_stored(content_type, reading.as_ref(), bytes, frame, n_joints)?;
    match reading.is_some_and(|reading| reading.inverse_poses) {
        true => Ok(set.with_inverse_poses()),
        false => Ok(set),
    }
}

/// The points of a stored upload as a CSV in the form of the documentation. Poses that are inverted for a job are here as they were uploaded.
///
/// # Errors
/// As [`from_upload`].
pub fn points_csv(
    content_type: &str,
    reading_json: Option<&str>,
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
) -> Result<Vec<u8>, Invalid> {
    let reading = stored_reading(reading_json)?;
    let set = parse_stored(content_type, reading.as_ref(), bytes, frame, n_joints)?;
    let instrument = reading.and_then(|reading| reading.instrument);
    let has_own_noise = instrument.is_none_or(|instrument| instrument.states_no_noise());
    points_csv::write(&set, has_own_noise)
        .map_err(|error| Invalid::at("", "unreadable", error.to_string()))
}

fn stored_reading(reading_json: Option<&str>) -> Result<Option<Reading>, Invalid> {
    let reading = reading_json.map(serde_json::from_str).transpose();
    reading.map_err(|error| Invalid::at("", "unreadable", error.to_string()))
}

fn parse_stored(
    content_type: &str,
    reading: Option<&Reading>,
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
) -> Result<MeasurementSet, Invalid> {
    if is_json(content_type) {
        let body = json_body(bytes)?;
        let reading = JsonReading {
            is_time: |_| true,
            // The stored reading also contains the instrument of the body. So it is used only if the body has none; otherwise the instrument would be
            // stated twice.
            instrument: (reading.and_then(|reading| reading.instrument))
                .filter(|_| body.instrument.is_none()),
        };
        return body.set_as(Some(frame), n_joints, &reading);
    }
    let rotation = declared_rotation(content_type);
    if let Some(reading) = reading {
        let files = Files::new(content_type, bytes)?;
        return table_upload::read_stored(reading, &files, rotation, frame, n_joints);
    }
    let decimal = declared_decimal(content_type).unwrap_or_default();
    own_form::parse_as(decimal, rotation, bytes, frame, n_joints)
        .map_err(|error| table_upload::table_error(&error))
}

fn is_json(content_type: &str) -> bool {
    content_type
        .to_ascii_lowercase()
        .starts_with("application/json")
}

fn json_body(bytes: &[u8]) -> Result<MeasurementSetBody, Invalid> {
    json::parse(bytes).map_err(|error| match error {
        json::Error::Shape(invalid) => invalid,
        json::Error::Syntax(detail) => Invalid::at("", "malformed_json", detail),
    })
}

/// Options for reading a measurement set in JSON.
struct JsonReading {
    is_time: TimeCheck,
    /// The instrument, if it is given separately from the body.
    instrument: Option<InstrumentBody>,
}

impl MeasurementSetBody {
    /// Converts the body to a measurement set, after the same checks as for CSV. `frame` and `instrument` come from the query.
    pub fn measurement_set(
        &self,
        frame: Option<Frame>,
        instrument: Option<InstrumentBody>,
        n_joints: usize,
    ) -> Result<MeasurementSet, Invalid> {
        let reading = JsonReading {
            is_time: is_rfc3339,
            instrument,
        };
        self.set_as(frame, n_joints, &reading)
    }

    /// The reading to store with the upload; none if no instrument is stated. `in_query` is the instrument that the query states.
    pub fn reading(&self, in_query: Option<InstrumentBody>) -> Option<Reading> {
        let instrument = self.instrument.or(in_query)?;
        Some(Reading {
            instrument: Some(instrument),
            ..Reading::default()
        })
    }

    fn set_as(
        &self,
        frame: Option<Frame>,
        n_joints: usize,
        reading: &JsonReading,
    ) -> Result<MeasurementSet, Invalid> {
        let frame = self.resolve_frame(frame)?.unwrap_or(DEFAULT_FRAME);
        let mut checker = Checker::default();
        checker.count("/points", self.points.len(), 1..=MAX_POINTS, "points");
        if let Some(name) = &self.name {
            checker.text("/name", name, MAX_NAME);
        }
        for (i, point) in self.points.iter().take(MAX_POINTS).enumerate() {
            point.check(
                &format!("/points/{i}"),
                n_joints,
                reading.is_time,
                &mut checker,
            );
        }
        self.check_alike(&mut checker);
        self.check_kinds(&mut checker);
        checker.finish("invalid_measurements")?;
        let points = self
            .points
            .iter()
            .enumerate()
            .map(|(row, point)| point.point(row))
            .collect();
        let mut set = MeasurementSet::new(frame, points);
        if let Some(stated) = instrument::resolve(self.instrument, reading.instrument)? {
            stated.apply_to(&mut set)?;
        }
        Ok(set)
    }

    /// Checks that all points state their noise in the same way, or that no point states it; likewise for the names of targets.
    fn check_alike(&self, checker: &mut Checker) {
        type States = fn(&PointBody) -> bool;
        let names = self.points.iter().map(|p| p.target_name.as_deref());
        let names: BTreeSet<Option<&str>> = names.collect();
        if names.len() > MAX_TARGETS {
            let n = names.len();
            let detail = format!("{n} target_name; a tool has at most {MAX_TARGETS} targets");
            checker.add("/points", "too_many_targets", detail);
        }
        let ways: [(&str, &str, States); 4] = [
            ("target_name", "mixed_target_names", |p| {
                p.target_name.is_some()
            }),
            ("std_mm", "mixed_std_mm", |p| p.std_mm.is_some()),
            ("std_axes_mm", "mixed_std", |p| p.std_axes_mm.is_some()),
            ("covariance_mm2", "mixed_std", |p| {
                p.covariance_mm2.is_some()
            }),
        ];
        for (name, code, states) in ways {
            let with_std = self.points.iter().filter(|p| states(p)).count();
            if with_std > 0
                && let Some(i) = self.points.iter().position(|p| !states(p))
            {
                let detail = format!(
                    "{with_std} of {} points have {name} and this one has none; give it to every point or to none",
                    self.points.len()
                );
                checker.add(format!("/points/{i}/{name}"), code, detail);
            }
        }
    }

    /// Checks that a set contains either only poses or only positions.
    fn check_kinds(&self, checker: &mut Checker) {
        let n_poses = self
            .points
            .iter()
            .filter(|p| p.quaternion.is_some())
            .count();
        let lacks = |p: &PointBody| n_poses > 0 && p.quaternion.is_none();
        if let Some(i) = self.points.iter().position(lacks) {
            let detail = format!(
                "{n_poses} of {} points are poses and this one has no quaternion; upload positions and poses as sets of their own",
                self.points.len()
            );
            checker.add(format!("/points/{i}/quaternion"), "mixed_kinds", detail);
        }
        let with_std = self
            .points
            .iter()
            .filter(|p| p.std_rotation_deg.is_some())
            .count();
        if with_std > 0 && with_std < self.points.len() {
            let detail = format!(
                "{with_std} of {} points have std_rotation_deg; give it to every pose or to none",
                self.points.len()
            );
            checker.add("/points", "mixed_std_rotation_deg", detail);
        }
    }

    /// The frame in the body, or the frame in the query; none if neither has a frame.
    ///
    /// # Errors
    /// [`Invalid`] if both have a frame and the frames differ.
    pub fn resolve_frame(&self, query: Option<Frame>) -> Result<Option<Frame>, Invalid> {
        match (self.frame, query) {
            (Some(body), Some(query)) if body != query => {
                let detail = format!(
                    "the body says {:?}, the query {:?}: drop one",
                    body.as_str(),
                    query.as_str()
                );
                Err(Invalid::at("/frame", "frame_conflict", detail))
            }
            (body, query) => Ok(body.or(query)),
        }
    }
}

/// Number of distinct targets.
pub fn n_targets(set: &MeasurementSet) -> usize {
    let targets: BTreeSet<usize> = set.points.iter().map(|p| p.target).collect();
    targets.len()
}
