//! Tools and rotations in requests.

use crate::measurement::columns::pose::unit_quaternion;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::robot::MAX_LENGTH_MM;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest deviation of a rotation matrix R from orthonormality: largest absolute entry of R·Rᵀ − 1.
pub(super) const ROTATION_TOLERANCE: f64 = 1e-6;

/// A tool: its pose in the flange frame of the nominal robot, as stored in the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolBody {
    /// Position of the tool centre point in the flange frame, mm.
    pub translation_mm: [f64; 3],
    /// Rotation: w, x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Rotation matrix, row by row; default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
    /// Standard uncertainty of one coordinate of `translation_mm`, mm, for a tool that was measured with this robot: by moving it about a point, or as a
    /// reflector at its tip. Default: the tool is known relative to the flange, as from a drawing, and the flange misses by the usual errors of
    /// `theta_offset` and `d` of the last link.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10000)]
    pub std_mm: Option<f64>,
}

/// The rotation of a quaternion or a matrix; the identity if neither is given.
pub fn rotation(quaternion: Option<[f64; 4]>, matrix: Option<[[f64; 3]; 3]>) -> Rotation3<f64> {
    if let Some(Ok(rotation)) = quaternion.map(unit_quaternion) {
        return rotation;
    }
    matrix.map_or_else(Rotation3::identity, |rows| {
        Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| rows[i][j]))
    })
}

/// A rotation as a unit quaternion w, x, y, z with w ≥ 0, as in all documents.
pub fn quaternion(rotation: &Rotation3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(rotation);
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.w, q.i, q.j, q.k].map(|x| sign * x)
}

/// Checks a rotation. `at` is the JSON pointer of the object that contains it.
pub(super) fn check_rotation(
    checker: &mut Checker,
    at: &str,
    quaternion: Option<[f64; 4]>,
    matrix: Option<[[f64; 3]; 3]>,
) {
    if quaternion.is_some() && matrix.is_some() {
        let detail = "a rotation is either a quaternion or a matrix (rotation): give one";
        checker.add(format!("{at}/quaternion"), "two_rotations", detail);
    }
    if let Some(Err((code, detail))) = quaternion.map(unit_quaternion) {
        checker.add(format!("{at}/quaternion"), code, detail);
    }
    let Some(rows) = matrix else {
        return;
    };
    let rotation = Matrix3::from_fn(|i, j| rows[i][j]);
    let off = (rotation * rotation.transpose() - Matrix3::identity()).amax();
    if off.is_nan() || off > ROTATION_TOLERANCE || rotation.determinant() < 0.0 {
        let detail = "it is not a rotation matrix: rows of length 1, at right angles, right-handed; leave it out for no rotation";
        checker.add(format!("{at}/rotation"), "not_a_rotation", detail);
    }
}

/// Checks that lengths are not too large. `at` is the JSON pointer of the list.
pub(super) fn check_lengths(checker: &mut Checker, at: &str, lengths_mm: &[f64; 3], largest: f64) {
    checker.magnitudes(at, lengths_mm, largest, "lengths are in millimetres");
}

/// Checks a standard uncertainty of lengths. `at` is the JSON pointer of the object that contains it.
pub(super) fn check_std(checker: &mut Checker, at: &str, std_mm: Option<f64>) {
    let what = "the standard uncertainty of one coordinate, mm";
    checker.within(format!("{at}/std_mm"), std_mm, 0.0..=MAX_LENGTH_MM, what);
}

impl ToolBody {
    /// Checks the tool. `at` is its JSON pointer.
    pub(super) fn check_into(&self, at: &str, checker: &mut Checker) {
        let lengths = format!("{at}/translation_mm");
        check_lengths(checker, &lengths, &self.translation_mm, MAX_LENGTH_MM);
        check_rotation(checker, at, self.quaternion, self.rotation);
        check_std(checker, at, self.std_mm);
    }

    /// Checks a tool that is a whole request body.
    pub fn check(&self) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        self.check_into("", &mut checker);
        checker.finish("invalid_tool")
    }
}

impl From<ToolBody> for IsometryMatrix3<f64> {
    fn from(tool: ToolBody) -> Self {
        Self::from_parts(
            Translation3::from(Vector3::from(tool.translation_mm)),
            rotation(tool.quaternion, tool.rotation),
        )
    }
}
