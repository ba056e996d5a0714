//! Cells of a row with the orientation of the target, and with uncertainties by axis.

use crate::measurement::position_noise::{NOT_A_COVARIANCE, PositionNoise};
use crate::measurement::rotation_convention::{CONVENTIONS, RotationConvention};
use crate::measurement::set::Point;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Largest deviation of a quaternion's length from 1. In files with three digits the length is off by a thousandth.
pub const MAX_QUATERNION_OFF: f64 = 2e-3;
/// Largest absolute angle of a rotation, rad: ten turns.
pub const MAX_ROTATION_RAD: f64 = 20.0 * std::f64::consts::PI;
/// Largest standard uncertainty of a rotation, rad (90°).
pub const MAX_STD_ROTATION_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Smallest standard uncertainty of a rotation, rad. No instrument is better than a nanoradian.
pub const MIN_STD_ROTATION_RAD: f64 = 1.0e-9;

/// Columns with rotations, uncertainties by axis, and the kind of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseColumn {
    /// Component of a quaternion: 0 to 3 for w, x, y, z.
    Quaternion(usize),
    /// Angle: 0 to 2 for rx, ry, rz.
    Angle(usize),
    /// Standard uncertainty of the position along one axis, 0 to 2.
    StdAxis(usize),
    /// Entry of the covariance of the position, in the order of [`COVARIANCE`].
    Covariance(usize),
    /// Standard uncertainty of the rotation about one axis, 0 to 2.
    StdRotationAxis(usize),
    /// Standard uncertainty of the rotation, the same about each axis.
    StdRotation,
    /// Kind of the row: `pose` or `position`.
    Kind,
}

/// The column with this name, if there is one.
pub(super) fn pose_column(name: &str) -> Option<PoseColumn> {
    use PoseColumn::{Angle, Covariance, Kind, Quaternion, StdAxis, StdRotation, StdRotationAxis};
    if let Some(entry) = COVARIANCE.iter().position(|known| *known == name) {
        return Some(Covariance(entry));
    }
    Some(match name {
        "quat_w" => Quaternion(0),
        "quat_x" => Quaternion(1),
        "quat_y" => Quaternion(2),
        "quat_z" => Quaternion(3),
        "rx_deg" => Angle(0),
        "ry_deg" => Angle(1),
        "rz_deg" => Angle(2),
        "std_x_mm" => StdAxis(0),
        "std_y_mm" => StdAxis(1),
        "std_z_mm" => StdAxis(2),
        "std_rx_deg" => StdRotationAxis(0),
        "std_ry_deg" => StdRotationAxis(1),
        "std_rz_deg" => StdRotationAxis(2),
        "std_rotation_deg" => StdRotation,
        "kind" => Kind,
        _ => return None,
    })
}

/// Columns of the covariance of the position: the entries on and above its diagonal, row by row.
const COVARIANCE: [&str; 6] = [
    "cov_xx_mm2",
    "cov_xy_mm2",
    "cov_xz_mm2",
    "cov_yy_mm2",
    "cov_yz_mm2",
    "cov_zz_mm2",
];

/// Groups of columns. A file has either all columns of a group or none.
const GROUPS: [(&str, &[&str]); 5] = [
    (
        "incomplete_quaternion",
        &["quat_w", "quat_x", "quat_y", "quat_z"],
    ),
    ("incomplete_rotation", &["rx_deg", "ry_deg", "rz_deg"]),
    ("incomplete_std", &["std_x_mm", "std_y_mm", "std_z_mm"]),
    (
        "incomplete_std",
        &["std_rx_deg", "std_ry_deg", "std_rz_deg"],
    ),
    ("incomplete_covariance", &COVARIANCE),
];

/// Errors in the combination of columns: column, code and detail.
pub fn header_issues(
    has: &dyn Fn(&str) -> bool,
    rotation: Option<RotationConvention>,
) -> Vec<(String, &'static str, String)> {
    let mut issues = Vec::new();
    for (code, group) in GROUPS {
        let missing: Vec<&str> = group.iter().copied().filter(|name| !has(name)).collect();
        if !missing.is_empty() && missing.len() < group.len() {
            let detail = format!(
                "{} belong together, and {} is missing: add it, or leave the others out",
                group.join(", "),
                missing.join(", ")
            );
            issues.push((missing[0].to_string(), code, detail));
        }
    }
    let (has_quaternion, has_angles) = (has("quat_w"), has("rx_deg"));
    let mut both = |one: &str, other: &str, why: &str| {
        if has(one) && has(other) {
            let detail = format!("{one} and {other} say the same twice: {why}");
            issues.push((other.to_string(), "duplicate_column", detail));
        }
    };
    both("quat_w", "rx_deg", "keep the quaternion or the angles");
    both("std_mm", "std_x_mm", "keep one of them");
    both("std_mm", "cov_xx_mm2", "keep one of them");
    both("std_x_mm", "cov_xx_mm2", "keep one of them");
    both("std_rotation_deg", "std_rx_deg", "keep one of them");
    if has_angles && !has_quaternion && rotation.is_none() && issues.is_empty() {
        let detail = format!(
            "rx_deg, ry_deg and rz_deg are a rotation only with a convention: say rotation={CONVENTIONS}. Nothing is guessed"
        );
        issues.push(("rx_deg".into(), ROTATION_REQUIRED, detail));
    }
    if !has_angles && rotation.is_some() && issues.is_empty() {
        let detail = "a convention of rotations is stated, and the file has no columns rx_deg, ry_deg and rz_deg: leave it out";
        issues.push(("rx_deg".into(), "missing_column", detail.into()));
    }
    for name in ["std_rx_deg", "std_rotation_deg"] {
        if has(name) && !has_angles && !has_quaternion && issues.is_empty() {
            let detail = format!(
                "{name} is the uncertainty of a rotation, and the file has none: leave it out"
            );
            issues.push((name.into(), "missing_column", detail));
        }
    }
    issues
}

/// Code of the error for angles without a rotation convention.
pub const ROTATION_REQUIRED: &str = "rotation_required";

/// The values of the pose columns of one row.
#[derive(Clone, Debug, Default)]
pub struct PoseCells {
    quaternion: [Option<f64>; 4],
    angles_rad: [Option<f64>; 3],
    std_axes_mm: [Option<f64>; 3],
    covariance_mm2: [Option<f64>; 6],
    std_rotation_axes_rad: [Option<f64>; 3],
    std_rotation_rad: Option<f64>,
    kind: Option<String>,
}

impl PoseCells {
    /// Stores the value of a column.
    pub fn set(&mut self, column: PoseColumn, value: f64) {
        match column {
            PoseColumn::Quaternion(k) => self.quaternion[k] = Some(value),
            PoseColumn::Angle(k) => self.angles_rad[k] = Some(value),
            PoseColumn::StdAxis(k) => self.std_axes_mm[k] = Some(value),
            PoseColumn::Covariance(k) => self.covariance_mm2[k] = Some(value),
            PoseColumn::StdRotationAxis(k) => self.std_rotation_axes_rad[k] = Some(value),
            PoseColumn::StdRotation => self.std_rotation_rad = Some(value),
            PoseColumn::Kind => {}
        }
    }

    /// Stores the kind of the row.
    pub fn set_kind(&mut self, kind: &str) {
        self.kind = Some(kind.to_string());
    }

    /// Writes the values to the point of the row. An error consists of column, code and detail.
    pub fn finish(
        self,
        point: &mut Point,
        rotation: Option<RotationConvention>,
    ) -> Result<(), (&'static str, &'static str, String)> {
        if let Some([w, x, y, z]) = all_of(self.quaternion) {
            let found = unit_quaternion([w, x, y, z]);
            let found = found.map_err(|(code, detail)| ("quat_w", code, detail))?;
            point.rotation = Some(found);
        }
        if let (Some(angles), Some(convention)) = (all_of(self.angles_rad), rotation) {
            let angles = Vector3::from(angles);
            point.rotation = Some(convention.rotation(&angles));
            point.rotation_angles_rad = Some(angles);
        }
        let of_axes = all_of(self.std_axes_mm).map(Vector3::from);
        point.position_noise = of_axes.map(PositionNoise::of_axes);
        if let Some([xx, xy, xz, yy, yz, zz]) = all_of(self.covariance_mm2) {
            let covariance_mm2 = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
            let noise = PositionNoise::of_stated_covariance(&covariance_mm2)
                .map_err(|detail| (COVARIANCE[0], NOT_A_COVARIANCE, detail))?;
            point.position_noise = Some(noise);
        }
        let of_axes = all_of(self.std_rotation_axes_rad);
        point.std_rotation_rad = self
            .std_rotation_rad
            .or(of_axes.map(|axes| Vector3::from(axes).norm() / 3.0_f64.sqrt()));
        let is_pose = point.rotation.is_some();
        match self.kind.as_deref() {
            None => Ok(()),
            Some("pose") if is_pose => Ok(()),
            Some("position") if !is_pose => Ok(()),
            Some("pose") => Err((
                "kind",
                "mixed_kinds",
                "the row is a pose by its kind, and the file has no columns of a rotation (quat_w … quat_z, or rx_deg ry_deg rz_deg)".into(),
            )),
            Some("position") => Err((
                "kind",
                "mixed_kinds",
                "the row is a position by its kind, and the file has columns of a rotation: upload positions and poses as sets of their own".into(),
            )),
            Some(other) => Err((
                "kind",
                "unknown_kind",
                format!("{other:?} is neither position nor pose; planes, points and distances cannot be identified from yet"),
            )),
        }
    }
}

fn all_of<const N: usize>(cells: [Option<f64>; N]) -> Option<[f64; N]> {
    let all: Option<Vec<f64>> = cells.into_iter().collect();
    all?.try_into().ok()
}

/// Converts a quaternion w, x, y, z to a rotation. An error consists of code and detail.
///
/// # Errors
/// If the length of the quaternion is not 1.
pub fn unit_quaternion([w, x, y, z]: [f64; 4]) -> Result<Rotation3<f64>, (&'static str, String)> {
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    if (norm - 1.0).abs() > MAX_QUATERNION_OFF || norm.is_nan() {
        let detail = format!(
            "the quaternion {w}, {x}, {y}, {z} (w, x, y, z) has the length {norm:.4}, a rotation's is 1: is it normalised, and in this order?"
        );
        return Err(("quaternion_not_normalised", detail));
    }
    let unit = UnitQuaternion::new_unchecked(q / norm);
    Ok(unit.to_rotation_matrix())
}
