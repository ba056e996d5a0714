//! A measured point in JSON, and its checks.

use crate::measurement::columns::pose::{
    MAX_STD_ROTATION_RAD, MIN_STD_ROTATION_RAD, unit_quaternion,
};
use crate::measurement::csv::{
    EXAMPLE_OF_A_TIME, MAX_COORDINATE_MM, MAX_STD_MM, MAX_TARGETS, MAX_TEMPERATURE_C, MIN_STD_MM,
};
use crate::measurement::position_noise::{NOT_A_COVARIANCE, PositionNoise};
use crate::measurement::{Point, Subset};
use crate::wire::instrument;
use crate::wire::issue::Checker;
use crate::wire::json;
use crate::wire::robot::MAX_NAME;
use crate::wire::tool::check_lengths;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of joint values that are read per point. It is larger than the number of joints of any robot, so that the later check can report
/// the expected number.
const MAX_LISTED: usize = 1_000;

/// Largest absolute joint value, degrees: ten turns.
pub const MAX_JOINT_VALUE_DEG: f64 = 3_600.0;

/// Check of `measured_at`. New uploads must have a time; older stored uploads may have any label.
pub type TimeCheck = fn(&str) -> bool;

/// One measured position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PointBody {
    /// The controller's joint values, degrees.
    #[serde(deserialize_with = "json::at_most::<_, _, MAX_LISTED>")]
    pub q_deg: Vec<f64>,
    /// Measured position of the target, mm.
    pub position_mm: [f64; 3],
    /// For a pose: orientation of the target in the measuring frame, as a unit quaternion w, x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Label of the arm configuration. Points of the same configuration have the same label. Default: points with equal joint values are one
    /// configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub configuration: Option<String>,
    /// Number of the reflector on the tool, 0-based; default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 31)]
    pub target: Option<usize>,
    /// Name of the reflector, instead of `target`. Targets are numbered in the order in which their names appear. Sessions that are fitted together share
    /// the targets of one name: the reflector was not mounted anew between them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_name: Option<String>,
    /// Whether the point is fitted (`identify`) or only scored (`verify`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subset: Option<Subset>,
    /// Standard uncertainty of each coordinate of this point, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_mm: Option<f64>,
    /// Standard uncertainty of this point along x, y and z of the measuring frame, mm. Instead of `std_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_axes_mm: Option<[f64; 3]>,
    /// Covariance of this point in the measuring frame, mm², row by row; symmetric with positive eigenvalues. Instead of `std_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance_mm2: Option<[[f64; 3]; 3]>,
    /// For a pose: standard uncertainty of the rotation about each axis, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(exclusive_minimum = 0, maximum = 90)]
    pub std_rotation_deg: Option<f64>,
    /// Label of the station, i.e. of the set-up of the instrument.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub station: Option<String>,
    /// Label of the measuring session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Position in the measuring order; default: the order of the points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<i64>,
    /// Air temperature at the robot, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Time of the measurement, RFC 3339. It is stored with the upload.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_at: Option<String>,
}

/// Checks the joint values `q_deg` at the JSON pointer `at`.
pub(super) fn check_joints(checker: &mut Checker, at: &str, q_deg: &[f64], n_joints: usize) {
    let what = "one joint value per link of the robot";
    checker.length(at, q_deg.len(), n_joints, what);
    checker.magnitudes(
        at,
        q_deg,
        MAX_JOINT_VALUE_DEG,
        "joint values are in degrees",
    );
}

impl PointBody {
    /// Adds an issue to `checker` for each invalid value.
    pub fn check(&self, at: &str, n_joints: usize, is_time: TimeCheck, checker: &mut Checker) {
        check_joints(checker, &format!("{at}/q_deg"), &self.q_deg, n_joints);
        let position = format!("{at}/position_mm");
        check_lengths(checker, &position, &self.position_mm, MAX_COORDINATE_MM);
        let what = "targets are numbered from 0";
        checker.within(
            format!("{at}/target"),
            self.target,
            0..=MAX_TARGETS - 1,
            what,
        );
        if self.target.is_some() && self.target_name.is_some() {
            let detail = "target and target_name both say the reflector: leave one of them out";
            checker.add(format!("{at}/target_name"), "duplicate_target", detail);
        }
        let std = "a standard uncertainty, mm";
        checker.within(
            format!("{at}/std_mm"),
            self.std_mm,
            MIN_STD_MM..=MAX_STD_MM,
            std,
        );
        self.check_directions(at, checker);
        if let Some(Err((code, detail))) = self.quaternion.map(unit_quaternion) {
            checker.add(format!("{at}/quaternion"), code, detail);
        }
        let range_deg = MIN_STD_ROTATION_RAD.to_degrees()..=MAX_STD_ROTATION_RAD.to_degrees();
        checker.within(
            format!("{at}/std_rotation_deg"),
            self.std_rotation_deg,
            range_deg,
            "a standard uncertainty of a rotation, degrees",
        );
        if self.std_rotation_deg.is_some() && self.quaternion.is_none() {
            let detail = "only a pose has std_rotation_deg: add a quaternion, or remove it";
            checker.add(format!("{at}/std_rotation_deg"), "mixed_kinds", detail);
        }
        let temperature_c = self.temperature_c.unwrap_or(0.0);
        let hint = "temperatures are in °C";
        checker.magnitude(
            format!("{at}/temperature_c"),
            temperature_c,
            MAX_TEMPERATURE_C,
            hint,
        );
        for (label, name) in [
            (&self.configuration, "configuration"),
            (&self.target_name, "target_name"),
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
            checker.add(format!("{at}/measured_at"), "not_a_time", detail);
        }
    }

    /// Checks the noise that is stated per axis or as a covariance, and that the noise is stated only once.
    fn check_directions(&self, at: &str, checker: &mut Checker) {
        for (k, std) in self.std_axes_mm.iter().flatten().enumerate() {
            let pointer = format!("{at}/std_axes_mm/{k}");
            let what = "a standard uncertainty, mm";
            checker.within(pointer, *std, MIN_STD_MM..=MAX_STD_MM, what);
        }
        if let Some(covariance) = self.covariance_mm2 {
            let noise = PositionNoise::of_stated_covariance(&matrix(covariance));
            if let Err(detail) = noise {
                checker.add(format!("{at}/covariance_mm2"), NOT_A_COVARIANCE, detail);
            }
        }
        let stated = [
            ("std_mm", self.std_mm.is_some()),
            ("std_axes_mm", self.std_axes_mm.is_some()),
            ("covariance_mm2", self.covariance_mm2.is_some()),
        ];
        let mut names = stated.iter().filter(|(_, is)| *is).map(|(name, _)| name);
        if let (Some(one), Some(other)) = (names.next(), names.next()) {
            let detail = format!("{one} and {other} say the same twice: keep one of them");
            checker.add(
                format!("{at}/{other}"),
                instrument::NOISE_STATED_TWICE,
                detail,
            );
        }
    }

    /// Converts the body to a point. The body must have been checked before.
    pub fn point(&self, row: usize) -> Point {
        let of_axes = self.std_axes_mm.map(Vector3::from);
        let of_covariance = self.covariance_mm2.map(matrix);
        Point {
            q_rad: self.q_deg.iter().map(|deg| deg.to_radians()).collect(),
            position_mm: Vector3::from(self.position_mm),
            configuration: self.configuration.clone().unwrap_or_default(),
            name: None,
            line: None,
            target: self.target.unwrap_or(0),
            target_name: self.target_name.clone(),
            subset: self.subset,
            std_mm: self.std_mm,
            station: self.station.clone(),
            session: self.session.clone(),
            sequence: self.sequence.unwrap_or(row as i64),
            measured_at: self.measured_at.clone(),
            temperature_c: self.temperature_c,
            sweep_joint: None,
            rotation: self.quaternion.and_then(|q| unit_quaternion(q).ok()),
            position_noise: of_axes
                .map(PositionNoise::of_axes)
                .or(of_covariance.and_then(|c| PositionNoise::of_covariance(&c))),
            std_rotation_rad: self.std_rotation_deg.map(f64::to_radians),
            rotation_angles_rad: None,
            lever_mm: Vector3::zeros(),
        }
    }
}

fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}
