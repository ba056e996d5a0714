//! Named work frames and tools of a robot.

use crate::compensation::FixturePoint;
use crate::measurement::csv::MAX_LABEL_LENGTH;
use crate::wire::compensate::OWN_FRAMES;
use crate::wire::frames::Transform;
use crate::wire::id::MAX_ID;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::measurement::Warning;
use crate::wire::tool::{ToolBody, check_lengths, check_rotation, check_std};
use nalgebra::IsometryMatrix3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of points of a measured frame.
pub const MAX_FIXTURE_POINTS: usize = 1000;
/// Largest absolute coordinate of a point of a fixture, mm.
pub(super) const MAX_FIXTURE_MM: f64 = 100_000.0;

/// The reference frame in which a work frame is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorkFrameReference {
    /// The robot's base frame, as defined in the controller.
    #[default]
    Base,
    /// The measuring frame of a measurement set.
    Measuring,
}

/// A work frame: either typed in (`translation_mm` with `quaternion` or `rotation`), or measured (`points`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkFrameBody {
    /// The reference frame of the numbers; default: `base`.
    #[serde(default)]
    pub reference: WorkFrameReference,
    /// With `reference: measuring`: the measurement set whose measuring frame is the reference. The work frame can be used with parameter sets that
    /// were identified from this measurement set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_set_id: Option<String>,
    /// With a measurement set of several stations: the station from which the numbers were measured. It has to be the one whose frame the identified
    /// parameters have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub station: Option<String>,
    /// Origin of the work frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translation_mm: Option<[f64; 3]>,
    /// Rotation: w, x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Rotation matrix, row by row; default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
    /// Three or more points that were measured and whose nominal positions in the work frame are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_items = 3, max_items = 1000)]
    pub points: Option<Vec<FixturePointBody>>,
    /// Standard uncertainty of one coordinate of a measured point, mm, as stated for the instrument. If the residuals show a larger uncertainty, the
    /// larger one is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_mm: Option<f64>,
}

/// A point of a fixture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixturePointBody {
    /// Nominal position in the work frame, mm.
    pub nominal_mm: [f64; 3],
    /// Measured position in the reference frame, mm.
    pub measured_mm: [f64; 3],
}

/// A stored work frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = WorkFrame)]
pub struct WorkFrameAnswer {
    /// Its name.
    pub name: String,
    /// The reference frame in which it is given.
    pub reference: WorkFrameReference,
    /// With `reference: measuring`: the measurement set whose measuring frame is the reference.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_set_id: Option<String>,
    /// Pose of the work frame in the reference frame.
    pub t_reference_work: Transform,
    /// Residual of each point, mm: distance between its measured and its fitted position. Empty for a frame that was typed in.
    pub residuals_mm: Vec<f64>,
    /// Root mean square of the residuals, mm; absent for a frame that was typed in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_mm: Option<f64>,
    /// Standard uncertainty of the origin of the work frame (3-D), mm; absent for a frame that was typed in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origin_std_mm: Option<f64>,
    /// A point is off, the scatter exceeds `std_mm`, or there are only three points, which allow no check.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
    /// RFC 3339, UTC.
    pub created_at: String,
}

/// A stored tool.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = NamedTool)]
pub struct ToolAnswer {
    /// Its name.
    pub name: String,
    /// Pose of the tool in the flange frame.
    pub t_flange_tool: Transform,
    /// Standard uncertainty of one coordinate of the tool centre point, mm; absent for a tool that is known relative to the flange, as from a drawing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_mm: Option<f64>,
    /// RFC 3339, UTC.
    pub created_at: String,
}

/// Checks the name of a work frame or tool.
pub fn check_name(name: &str, max: usize) -> Result<(), Invalid> {
    let mut checker = Checker::default();
    checker.words("/name", name, max);
    if name.trim() != name || name.contains('/') {
        let detail = "a name has no space around it and no / in it";
        checker.add("/name", "invalid_name", detail);
    }
    if OWN_FRAMES.contains(&name) {
        let detail = format!("{name} is a frame that every robot has: take another name");
        checker.add("/name", "reserved_name", detail);
    }
    checker.finish("invalid_name")
}

impl WorkFrameBody {
    /// Makes all checks that need only the body.
    ///
    /// # Errors
    /// [`Invalid`] with every field that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        let is_typed =
            self.translation_mm.is_some() || self.quaternion.is_some() || self.rotation.is_some();
        match (&self.points, is_typed) {
            (Some(_), true) => checker.add(
                "/points",
                "typed_and_measured",
                "a work frame is either typed (translation_mm, quaternion or rotation) or measured (points): give one",
            ),
            (None, false) => checker.add(
                "",
                "no_frame",
                "give translation_mm with quaternion or rotation, or three or more points that were measured",
            ),
            _ => (),
        }
        match (self.reference, &self.measurement_set_id) {
            (WorkFrameReference::Measuring, None) => checker.add(
                "/measurement_set_id",
                "missing",
                "each set-up of the instrument has a measuring frame of its own: name the measurement set in whose frame the numbers are given",
            ),
            (WorkFrameReference::Base, Some(_)) => checker.add(
                "/measurement_set_id",
                "not_of_base",
                "it goes with reference measuring; numbers in the base frame need no set",
            ),
            _ => (),
        }
        if self.reference == WorkFrameReference::Base && self.station.is_some() {
            let detail = "a station goes with reference measuring: remove it";
            checker.add("/station", "not_of_base", detail);
        }
        if let Some(id) = &self.measurement_set_id {
            checker.text("/measurement_set_id", id, MAX_ID);
        }
        if let Some(station) = &self.station {
            checker.text("/station", station, MAX_LABEL_LENGTH);
        }
        if let Some(origin) = &self.translation_mm {
            check_lengths(&mut checker, "/translation_mm", origin, MAX_FIXTURE_MM);
        }
        check_rotation(&mut checker, "", self.quaternion, self.rotation);
        let points = self.points.as_deref().unwrap_or_default();
        checker.count("/points", points.len(), 0..=MAX_FIXTURE_POINTS, "points");
        for (i, point) in points.iter().take(MAX_FIXTURE_POINTS).enumerate() {
            let at = format!("/points/{i}");
            let mut lengths = |field: &str, lengths_mm: &[f64; 3]| {
                check_lengths(
                    &mut checker,
                    &format!("{at}/{field}"),
                    lengths_mm,
                    MAX_FIXTURE_MM,
                );
            };
            lengths("nominal_mm", &point.nominal_mm);
            lengths("measured_mm", &point.measured_mm);
        }
        check_std(&mut checker, "", self.std_mm);
        checker.finish("invalid_work_frame")
    }
}

impl ToolBody {
    /// The answer for a stored tool.
    pub fn answer(self, name: String, created_at: String) -> ToolAnswer {
        ToolAnswer {
            name,
            t_flange_tool: Transform::from(&IsometryMatrix3::from(self)),
            std_mm: self.std_mm,
            created_at,
        }
    }
}

impl From<&FixturePointBody> for FixturePoint {
    fn from(point: &FixturePointBody) -> Self {
        Self {
            nominal_mm: point.nominal_mm.into(),
            measured_mm: point.measured_mm.into(),
        }
    }
}
