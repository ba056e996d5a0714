//! Preliminary frames from sweeps (section 2.2 of the paper).

use crate::frames::{PreliminaryFrames, SweepCircle};
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A rigid transformation: p_to = rotation · p_from + translation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Transform {
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
    /// Translation, mm.
    pub translation_mm: [f64; 3],
}

impl From<&IsometryMatrix3<f64>> for Transform {
    fn from(t: &IsometryMatrix3<f64>) -> Self {
        let r = t.rotation.matrix();
        let row = |i| [r[(i, 0)], r[(i, 1)], r[(i, 2)]];
        Self {
            rotation: [row(0), row(1), row(2)],
            translation_mm: t.translation.vector.into(),
        }
    }
}

/// Restores the transformation bit for bit, without normalising the rotation matrix.
impl From<&Transform> for IsometryMatrix3<f64> {
    fn from(transform: &Transform) -> Self {
        let matrix = Matrix3::from_fn(|i, j| transform.rotation[i][j]);
        Self::from_parts(
            Translation3::from(Vector3::from(transform.translation_mm)),
            Rotation3::from_matrix_unchecked(matrix),
        )
    }
}

/// Base and tool frame, with the fitted circles that they were computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FramesContent {
    /// Base frame in the instrument's frame.
    pub t_instrument_base: Transform,
    /// Distance of the target from the flange along the flange's axis, mm.
    pub z_tool_mm: f64,
    /// The fitted circle of each swept joint.
    pub circles: Vec<Circle>,
}

/// A circle fitted to one sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Circle {
    /// The joint that moved, 1-based.
    pub joint: usize,
    /// Centre in the instrument's frame, mm.
    pub centre_mm: [f64; 3],
    /// Unit normal along the joint's positive axis.
    pub normal: [f64; 3],
    /// Radius, mm.
    pub radius_mm: f64,
    /// Root mean square distance of the points from the circle, mm.
    pub rms_mm: f64,
}

/// Stored frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FramesAnswer {
    /// Opaque identifier; a job takes it as `frames_id`.
    pub id: String,
    /// The robot that was swept.
    pub robot_id: String,
    /// Base frame in the instrument's frame.
    pub t_instrument_base: Transform,
    /// Distance of the target from the flange along the flange's axis, mm.
    pub z_tool_mm: f64,
    /// The fitted circle of each swept joint.
    pub circles: Vec<Circle>,
    /// RFC 3339, UTC.
    pub created_at: String,
}

impl From<&PreliminaryFrames> for FramesContent {
    fn from(frames: &PreliminaryFrames) -> Self {
        Self {
            t_instrument_base: Transform::from(&frames.t_instrument_base),
            z_tool_mm: frames.z_tool_mm,
            circles: frames.circles.iter().map(Circle::from).collect(),
        }
    }
}

impl From<&FramesContent> for PreliminaryFrames {
    fn from(content: &FramesContent) -> Self {
        Self {
            t_instrument_base: IsometryMatrix3::from(&content.t_instrument_base),
            z_tool_mm: content.z_tool_mm,
            circles: content.circles.iter().map(SweepCircle::from).collect(),
        }
    }
}

impl From<&SweepCircle> for Circle {
    fn from(circle: &SweepCircle) -> Self {
        Self {
            joint: circle.joint,
            centre_mm: circle.centre_mm.into(),
            normal: circle.normal.into(),
            radius_mm: circle.radius_mm,
            rms_mm: circle.rms_mm,
        }
    }
}

impl From<&Circle> for SweepCircle {
    fn from(circle: &Circle) -> Self {
        Self {
            joint: circle.joint,
            centre_mm: circle.centre_mm.into(),
            normal: circle.normal.into(),
            radius_mm: circle.radius_mm,
            rms_mm: circle.rms_mm,
        }
    }
}
