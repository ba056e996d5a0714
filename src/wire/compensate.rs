//! Corrected joint targets.

pub use crate::compensation::{Base, Mode, Status};
use crate::wire::corrections::PayloadBody;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::measurement::Warning;
use crate::wire::predict::check_pose;
use crate::wire::robot::MAX_LENGTH_MM;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most targets of one request: some seconds of one core.
pub const MAX_TARGETS_PER_REQUEST: usize = 20_000;
/// Largest deviation of a rotation's rows and columns from unit length and from right angles.
pub(super) const ROTATION_TOLERANCE: f64 = 1e-6;

/// Targets to correct. They must have been programmed offline: taught targets already contain the robot's errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CompensateBody {
    /// The controller's joint values, degrees, target by target.
    #[schema(max_items = 20000)]
    #[serde(deserialize_with = "json::at_most::<_, _, { 2 * MAX_TARGETS_PER_REQUEST }>")]
    pub q_deg: Vec<Vec<f64>>,
    /// The tool is this reflector, 0-based.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 31)]
    pub target: Option<usize>,
    /// The tool centre point instead of a reflector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolBody>,
    /// Whether the tool's pose is corrected, or only its position.
    #[serde(default)]
    pub mode: Mode,
    /// The frame in which targets are reached; default: `measured` if positions were measured in the base frame, else `robot`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<Base>,
    /// Payload at these targets; default: the payload at the identification. Without corrections it has no effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<PayloadBody>,
}

/// A tool centre point in the flange frame of the nominal robot, as controllers store it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolBody {
    /// mm.
    pub translation_mm: [f64; 3],
    /// Rotation matrix, row by row; default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
}

/// The frame of position and orientation errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorFrame {
    /// The measuring frame, with `base: measured`.
    Measuring,
    /// The robot's own base frame, with `base: robot`.
    RobotBase,
}

/// Corrected targets, in the order of the request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CompensateAnswer {
    /// The controller's joint values with which the robot has its tool where the nominal robot would have it, degrees.
    pub q_deg: Vec<Vec<f64>>,
    /// The frame of the errors below. Answers of older versions do not have this field; their frame is `robot_base`.
    #[serde(default = "ErrorFrame::default_robot_base")]
    pub frame: ErrorFrame,
    /// Position error of the tool with the requested joint values, mm.
    pub position_error_before_mm: Vec<f64>,
    /// Position error of the tool with the corrected joint values, by the identified robot, mm.
    pub position_error_after_mm: Vec<f64>,
    /// Orientation error of the tool with the corrected joint values, degrees.
    pub orientation_error_after_deg: Vec<f64>,
    /// Status of each target.
    pub status: Vec<Status>,
    /// True if the corrected target is outside the measured region, where corrections fade to the links alone; always false without
    /// corrections.
    pub extrapolated: Vec<bool>,
    /// Identified errors that are not corrected.
    #[serde(default)]
    pub left_out: LeftOut,
    /// Warnings: `pose_not_seen` if the measured positions do not determine the flange's pose completely, and this tool or mode depends on
    /// it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

/// Identified errors that are not corrected, because they count as the pose of base and tool. With `base: robot` these are all errors of
/// link 1 (also a wrong mastering of joint 1), and `theta_offset` and `d` of the last link. With `base: measured` the base is corrected and its
/// values are 0. Of the last link `theta_offset` is not corrected, nor `d` if it changed so much that it contains the length of a tool.
/// Corrected targets are right in a base frame and on a flange that have moved by these values: measure the work object and the tool with
/// this robot, or add the values to them. All are 0 if the set was identified from an instrument, which cannot determine them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeftOut {
    /// Rotation of the base frame from the nominal one, degrees. A wrong mastering of joint 1 rotates it about the axis of that joint.
    pub base_turn_deg: f64,
    /// Shift of the base frame from the nominal one, mm.
    pub base_shift_mm: f64,
    /// Rotation of the flange about the last axis, degrees.
    pub flange_turn_deg: f64,
    /// Shift of the flange along the last axis, mm.
    pub flange_shift_mm: f64,
}

impl CompensateAnswer {
    /// Appends the answer to the next part of a long program. `left_out` belongs to the parameter set and is the same in each part.
    pub fn extend(&mut self, next: Self) {
        self.q_deg.extend(next.q_deg);
        self.position_error_before_mm
            .extend(next.position_error_before_mm);
        self.position_error_after_mm
            .extend(next.position_error_after_mm);
        self.orientation_error_after_deg
            .extend(next.orientation_error_after_deg);
        self.status.extend(next.status);
        self.extrapolated.extend(next.extrapolated);
        self.left_out = next.left_out;
        self.warnings = next.warnings;
    }
}

impl CompensateBody {
    /// Checks that need only the request and the number of joints.
    ///
    /// # Errors
    /// [`Invalid`] with a JSON pointer to everything that is wrong.
    pub fn check(&self, n_joints: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        if self.q_deg.len() > MAX_TARGETS_PER_REQUEST {
            let detail = format!(
                "{} targets; at most {MAX_TARGETS_PER_REQUEST}: send a long program in parts",
                self.q_deg.len()
            );
            checker.note("/q_deg", "wrong_length", detail);
        }
        for (i, pose) in self.q_deg.iter().take(MAX_TARGETS_PER_REQUEST).enumerate() {
            check_pose(&mut checker, i, pose, n_joints);
        }
        if self.target.is_some() && self.tool.is_some() {
            checker.note(
                "/tool",
                "target_and_tool",
                "the tool is either a reflector (target) or a tool centre point (tool): give one",
            );
        }
        if let Some(tool) = &self.tool {
            tool.check(&mut checker);
        }
        if let Some(payload) = &self.payload {
            payload.check("/payload", &mut checker);
        }
        checker.finish("invalid_poses")
    }
}

impl ToolBody {
    /// Reports what is wrong, below `/tool`.
    pub(super) fn check(&self, checker: &mut Checker) {
        for (i, value) in self.translation_mm.iter().enumerate() {
            checker.magnitude(
                format!("/tool/translation_mm/{i}"),
                *value,
                MAX_LENGTH_MM,
                "lengths are in millimetres",
            );
        }
        let rotation = self.matrix();
        let off = (rotation * rotation.transpose() - Matrix3::identity()).amax();
        if off.is_nan() || off > ROTATION_TOLERANCE || rotation.determinant() < 0.0 {
            let detail = "it is not a rotation matrix: rows of length 1, at right angles, right-handed; leave it out for no rotation";
            checker.note("/tool/rotation", "not_a_rotation", detail);
        }
    }

    fn matrix(&self) -> Matrix3<f64> {
        self.rotation.map_or_else(Matrix3::identity, |rows| {
            Matrix3::from_fn(|i, j| rows[i][j])
        })
    }
}

impl From<ToolBody> for IsometryMatrix3<f64> {
    fn from(tool: ToolBody) -> Self {
        let rotation = Rotation3::from_matrix_unchecked(tool.matrix());
        Self::from_parts(
            Translation3::from(Vector3::from(tool.translation_mm)),
            rotation,
        )
    }
}

impl From<Base> for ErrorFrame {
    fn from(base: Base) -> Self {
        match base {
            Base::Measured => Self::Measuring,
            Base::Robot => Self::RobotBase,
        }
    }
}

impl ErrorFrame {
    fn default_robot_base() -> Self {
        Self::RobotBase
    }
}

impl CompensateAnswer {
    /// An answer without targets yet, with room for `n`.
    pub fn with_capacity(n: usize, frame: ErrorFrame) -> Self {
        Self {
            q_deg: Vec::with_capacity(n),
            frame,
            position_error_before_mm: Vec::with_capacity(n),
            position_error_after_mm: Vec::with_capacity(n),
            orientation_error_after_deg: Vec::with_capacity(n),
            status: Vec::with_capacity(n),
            extrapolated: Vec::with_capacity(n),
            left_out: LeftOut::default(),
            warnings: vec![],
        }
    }
}
