//! Measurement sets: parsing of CSV and JSON, and their summary.

use crate::measurement::RotationConvention;
use crate::measurement::csv::Conventions;
pub use crate::measurement::csv::MAX_TARGETS;
use crate::measurement::csv::{
    EXAMPLE_OF_A_TIME, MAX_COORDINATE_MM, MAX_STD_MM, MAX_TEMPERATURE_C, MIN_STD_MM,
};
use crate::measurement::csv_pose::{MAX_STD_ROTATION_RAD, MIN_STD_ROTATION_RAD, unit_quaternion};
pub use crate::measurement::sessions::joined;
pub use crate::measurement::set::n_shared_points;
use crate::measurement::{self, Point};
pub use crate::measurement::{Decimal, Frame, MeasurementSet, Subset};
use crate::wire::angle::{to_degrees, to_radians};
use crate::wire::columns::ColumnsBody;
use crate::wire::content_type::{declared_decimal, declared_rotation};
use crate::wire::issue::{Checker, Invalid, Issue, MAX_ISSUES};
use crate::wire::json;
use crate::wire::robot::MAX_NAME;
use crate::wire::suspicion::Insist;
use crate::wire::table_upload::{self, Files, StoredTable, UploadOptions};
use crate::wire::time::is_rfc3339;
use crate::wire::understood::{JoinedFiles, Reading, UnderstoodBody};
pub use crate::wire::warning::Warning;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// Most points of one set; the largest public campaigns have under a thousand.
pub const MAX_POINTS: usize = measurement::csv::MAX_ROWS;
/// Largest upload, bytes: 100,000 rows of 300 characters.
pub const MAX_UPLOAD_BYTES: usize = 32 * 1024 * 1024;
/// Largest number of joint values that are read per point. It exceeds that of any robot, so the check can report the expected number.
const MAX_LISTED: usize = 1_000;
/// Largest joint value, degrees: ten turns.
pub const MAX_JOINT_VALUE_DEG: f64 = 3_600.0;

/// Frame of an upload that does not declare it; the command line has the same default.
pub const DEFAULT_FRAME: Frame = Frame::Base;

/// A measurement set in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasurementSetBody {
    /// The frame of every position; may be given in the query instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// Its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// The points, in measuring order.
    #[serde(deserialize_with = "json::at_most::<_, _, MAX_POINTS>")]
    #[schema(min_items = 1, max_items = 100000)]
    pub points: Vec<PointBody>,
}

/// One measured position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PointBody {
    /// The controller's joint values, degrees.
    #[serde(deserialize_with = "json::at_most::<_, _, MAX_LISTED>")]
    pub q_deg: Vec<f64>,
    /// Measured position of the target, mm.
    pub position_mm: [f64; 3],
    /// How the target was turned in the measuring frame, of a pose: w, x, y, z, of length 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Points of one arm configuration share this label; default: equal joint values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub configuration: Option<String>,
    /// Which reflector on the tool, 0-based; default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 31)]
    pub target: Option<usize>,
    /// Whether it is fitted (`identify`) or only scored (`verify`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subset: Option<Subset>,
    /// Its own standard uncertainty, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_mm: Option<f64>,
    /// Standard uncertainty of the rotation about each axis, degrees, of a pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 90)]
    pub std_rotation_deg: Option<f64>,
    /// Label of the instrument's set-up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub station: Option<String>,
    /// Label of the measuring session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Place in the measuring order; default: the order of the points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<i64>,
    /// Air temperature at the robot, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// When it was measured, RFC 3339; stored with the upload.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_at: Option<String>,
}

/// Summary of a stored set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SetSummary {
    /// Opaque identifier.
    pub id: String,
    /// The robot it was measured on.
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
    /// Code of the suspicion that the uploader overrode with `insist`. No release rests on such a set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub insisted_on: Option<Insist>,
    /// How a table was understood; JSON and older sets have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understood: Option<UnderstoodBody>,
    /// How two files were understood and joined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joined: Option<JoinedFiles>,
    /// When it was archived: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
}

/// Check of `measured_at`: new uploads must have a time, older stored ones may have any label.
type TimeCheck = fn(&str) -> bool;

/// A file of measurements and what the caller says about it.
#[derive(Clone, Copy, Debug)]
pub struct Upload<'a> {
    /// Its content type: JSON, a form of several files, else a table.
    pub content_type: &'a str,
    /// Its bytes.
    pub bytes: &'a [u8],
    /// What its columns mean, where the file does not say it.
    pub columns: &'a ColumnsBody,
    /// Its decimal mark, where the caller states it beside the content type.
    pub decimal: Option<Decimal>,
    /// What angles of poses mean, where the caller states it beside the content type.
    pub rotation: Option<RotationConvention>,
    /// The frame of every position.
    pub frame: Frame,
}

/// Reads sweeps, or any other table with decimal marks as it writes them.
///
/// # Errors
/// [`Invalid`] with row, column and value of everything that is wrong.
pub fn from_table(bytes: &[u8], frame: Frame, n_joints: usize) -> Result<MeasurementSet, Invalid> {
    let upload = Upload {
        content_type: "text/csv",
        bytes,
        columns: &ColumnsBody::default(),
        decimal: None,
        rotation: None,
        frame,
    };
    Ok(from_file(&upload, n_joints)?.0)
}

/// Parses a new file, and tells how a table was understood.
///
/// # Errors
/// [`Invalid`] with row, column and value of everything that is wrong.
pub fn from_file(
    upload: &Upload,
    n_joints: usize,
) -> Result<(MeasurementSet, Option<Reading>), Invalid> {
    if is_json(upload.content_type) {
        let set = parse_json(upload.bytes, upload.frame, n_joints, is_rfc3339)?;
        return Ok((set, None));
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
    let (set, reading) = table_upload::read(&files, &options)?;
    Ok((set, Some(reading)))
}

/// Parses a stored upload. `reading_json` is how it was read; uploads that are older than that, and JSON, have none.
///
/// # Errors
/// [`Invalid`]; does not happen for bytes that were accepted once.
pub fn from_upload(
    content_type: &str,
    reading_json: Option<&str>,
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
) -> Result<MeasurementSet, Invalid> {
    if is_json(content_type) {
        return parse_json(bytes, frame, n_joints, |_| true);
    }
    let rotation = declared_rotation(content_type);
    if let Some(reading) = reading_json {
        let stored = StoredTable {
            content_type,
            reading_json: reading,
            bytes,
            rotation,
        };
        return table_upload::read_again(&stored, frame, n_joints);
    }
    let conventions = Conventions {
        decimal: declared_decimal(content_type).unwrap_or_default(),
        rotation,
        is_time: |_| true,
    };
    measurement::csv::parse_as(conventions, bytes, frame, n_joints).map_err(|error| Invalid {
        code: "invalid_measurements",
        issues: error
            .issues
            .into_iter()
            .take(MAX_ISSUES)
            .map(csv_issue)
            .collect(),
    })
}

fn is_json(content_type: &str) -> bool {
    content_type
        .to_ascii_lowercase()
        .starts_with("application/json")
}

fn parse_json(
    bytes: &[u8],
    frame: Frame,
    n_joints: usize,
    is_time: TimeCheck,
) -> Result<MeasurementSet, Invalid> {
    let body: MeasurementSetBody = json::parse(bytes).map_err(|error| match error {
        json::Error::Shape(invalid) => invalid,
        json::Error::Syntax(detail) => Invalid::at("", "malformed_json", detail),
    })?;
    body.set_with_times(Some(frame), n_joints, is_time)
}

fn csv_issue(issue: measurement::csv::Issue) -> Issue {
    Issue {
        row: issue.row,
        column: issue.column,
        code: issue.code.into(),
        detail: issue.detail,
        ..Issue::default()
    }
}

impl MeasurementSetBody {
    /// The measurement set, after the same checks as for CSV. `frame` is the frame of the query.
    ///
    /// # Errors
    /// [`Invalid`] with a JSON pointer to everything that is wrong.
    pub fn measurement_set(
        &self,
        frame: Option<Frame>,
        n_joints: usize,
    ) -> Result<MeasurementSet, Invalid> {
        self.set_with_times(frame, n_joints, is_rfc3339)
    }

    fn set_with_times(
        &self,
        frame: Option<Frame>,
        n_joints: usize,
        is_time: TimeCheck,
    ) -> Result<MeasurementSet, Invalid> {
        let frame = self.resolve_frame(frame)?.unwrap_or(DEFAULT_FRAME);
        let mut checker = Checker::default();
        if self.points.is_empty() || self.points.len() > MAX_POINTS {
            checker.note(
                "/points",
                "wrong_length",
                format!(
                    "{} points; 1 to {MAX_POINTS} are allowed",
                    self.points.len()
                ),
            );
        }
        if let Some(name) = &self.name {
            checker.text("/name", name, MAX_NAME);
        }
        for (i, point) in self.points.iter().take(MAX_POINTS).enumerate() {
            point.check(&format!("/points/{i}"), n_joints, is_time, &mut checker);
        }
        let with_std = self.points.iter().filter(|p| p.std_mm.is_some()).count();
        if with_std > 0
            && let Some(i) = self.points.iter().position(|p| p.std_mm.is_none())
        {
            let detail = format!(
                "{with_std} of {} points have std_mm and this one has none; give it to every point or to none",
                self.points.len()
            );
            checker.note(format!("/points/{i}/std_mm"), "mixed_std_mm", detail);
        }
        self.check_kinds(&mut checker);
        checker.finish("invalid_measurements")?;
        let points = self
            .points
            .iter()
            .enumerate()
            .map(|(row, point)| point.point(row))
            .collect();
        Ok(MeasurementSet::new(frame, points))
    }

    /// Poses and positions are sets of their own.
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
            checker.note(format!("/points/{i}/quaternion"), "mixed_kinds", detail);
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
            checker.note("/points", "mixed_std_rotation_deg", detail);
        }
    }

    /// The frame in the body, else that in the query; none if neither has one.
    ///
    /// # Errors
    /// [`Invalid`] if they differ.
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

impl PointBody {
    fn check(&self, at: &str, n_joints: usize, is_time: TimeCheck, checker: &mut Checker) {
        checker.length(
            format!("{at}/q_deg"),
            self.q_deg.len(),
            n_joints,
            "one joint value per link of the robot",
        );
        for (j, q) in self.q_deg.iter().enumerate() {
            checker.magnitude(
                format!("{at}/q_deg/{j}"),
                *q,
                MAX_JOINT_VALUE_DEG,
                "joint values are in degrees",
            );
        }
        for (j, x) in self.position_mm.iter().enumerate() {
            checker.magnitude(
                format!("{at}/position_mm/{j}"),
                *x,
                MAX_COORDINATE_MM,
                "positions are in millimetres",
            );
        }
        if let Some(target) = self.target.filter(|target| *target >= MAX_TARGETS) {
            checker.note(
                format!("{at}/target"),
                "out_of_range",
                format!("{target}: targets are numbered from 0, at most {MAX_TARGETS}"),
            );
        }
        if let Some(std) = self
            .std_mm
            .filter(|std| !(MIN_STD_MM..=MAX_STD_MM).contains(std))
        {
            let detail =
                format!("{std}: a standard uncertainty is {MIN_STD_MM} to {MAX_STD_MM} mm");
            checker.note(format!("{at}/std_mm"), "out_of_range", detail);
        }
        if let Some(Err((code, detail))) = self.quaternion.map(unit_quaternion) {
            checker.note(format!("{at}/quaternion"), code, detail);
        }
        let range_deg = to_degrees(MIN_STD_ROTATION_RAD)..=to_degrees(MAX_STD_ROTATION_RAD);
        if let Some(std) = self.std_rotation_deg.filter(|std| !range_deg.contains(std)) {
            let detail =
                format!("{std}: a standard uncertainty of a rotation is above 0 and at most 90°");
            checker.note(format!("{at}/std_rotation_deg"), "out_of_range", detail);
        }
        if self.std_rotation_deg.is_some() && self.quaternion.is_none() {
            let detail = "a position has no rotation whose uncertainty this could be";
            checker.note(format!("{at}/std_rotation_deg"), "mixed_kinds", detail);
        }
        if let Some(temperature_c) = self.temperature_c {
            checker.magnitude(
                format!("{at}/temperature_c"),
                temperature_c,
                MAX_TEMPERATURE_C,
                "temperatures are in °C",
            );
        }
        for (label, name) in [
            (&self.configuration, "configuration"),
            (&self.station, "station"),
            (&self.session, "session"),
            (&self.measured_at, "measured_at"),
        ] {
            if let Some(label) = label {
                checker.text(&format!("{at}/{name}"), label, MAX_NAME);
            }
        }
        if let Some(text) = self.measured_at.as_deref().filter(|text| !is_time(text)) {
            let shown: String = text.chars().take(40).collect();
            let detail = format!("{shown:?} is not a time; write it as {EXAMPLE_OF_A_TIME}");
            checker.note(format!("{at}/measured_at"), "not_a_time", detail);
        }
    }

    fn point(&self, row: usize) -> Point {
        Point {
            q_rad: self.q_deg.iter().map(|deg| to_radians(*deg)).collect(),
            position_mm: Vector3::from(self.position_mm),
            configuration: self.configuration.clone().unwrap_or_default(),
            target: self.target.unwrap_or(0),
            subset: self.subset,
            std_mm: self.std_mm,
            station: self.station.clone(),
            session: self.session.clone(),
            sequence: self.sequence.unwrap_or(row as i64),
            temperature_c: self.temperature_c,
            sweep_joint: None,
            rotation: self.quaternion.and_then(|q| unit_quaternion(q).ok()),
            std_axes_mm: None,
            std_rotation_rad: self.std_rotation_deg.map(to_radians),
            rotation_angles_rad: None,
        }
    }
}

/// Number of distinct targets.
pub fn n_targets(set: &MeasurementSet) -> usize {
    let targets: BTreeSet<usize> = set.points.iter().map(|p| p.target).collect();
    targets.len()
}
