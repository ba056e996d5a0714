//! Corrected joint targets.

pub use crate::compensation::{Base, Mode, Status};
use crate::wire::corrections::PayloadBody;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::measurement::Warning;
use crate::wire::predict::{check_joints, check_pose};
use crate::wire::robot::MAX_NAME;
use crate::wire::tool::{ToolBody, check_lengths, check_rotation, quaternion, rotation};
use nalgebra::{IsometryMatrix3, Translation3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most targets of one request: some seconds of one core.
pub const MAX_TARGETS_PER_REQUEST: usize = 20_000;
/// Farthest Cartesian target, mm.
pub(super) const MAX_TARGET_MM: f64 = 100_000.0;
/// Frames of targets that every robot has: its base frame, and the measuring frame.
pub const OWN_FRAMES: [&str; 2] = ["base", "measuring"];

/// Targets to correct: `q_deg`, or `targets`. They must have been programmed offline: taught targets already contain the robot's errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CompensateBody {
    /// The controller's joint values, degrees, target by target.
    #[schema(max_items = 20000)]
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "json::at_most::<_, _, { 2 * MAX_TARGETS_PER_REQUEST }>"
    )]
    pub q_deg: Vec<Vec<f64>>,
    /// Cartesian targets instead of `q_deg`.
    #[schema(max_items = 20000)]
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "json::at_most::<_, _, { 2 * MAX_TARGETS_PER_REQUEST }>"
    )]
    pub targets: Vec<CartesianTarget>,
    /// The frame of `targets`: `base` (default), `measuring`, or the name of a work frame of the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub frame: Option<String>,
    /// The tool is this reflector, 0-based.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 31)]
    pub target: Option<usize>,
    /// The tool centre point instead of a reflector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolBody>,
    /// The name of a tool of the robot, instead of `tool`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub tool_name: Option<String>,
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

/// A Cartesian target: where the tool has to be, and joint values near those that reach it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CartesianTarget {
    /// Position of the tool in `frame`, mm.
    pub position_mm: [f64; 3],
    /// Orientation of the tool in `frame`: w, x, y, z. With mode `pose` this or `rotation` is needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Orientation of the tool in `frame`: a rotation matrix, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
    /// The controller's joint values near the target, degrees: they choose the posture (elbow, wrist).
    pub q_near_deg: Vec<f64>,
}

/// A pose of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ToolPose {
    /// mm.
    pub position_mm: [f64; 3],
    /// w, x, y, z with w not negative.
    pub quaternion: [f64; 4],
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
    /// Standard uncertainty of the tool's position with the corrected joint values (3-D: the root of the three variances' sum), mm, in `frame`: of
    /// the identified links and of the work frame. The robot's repeatability comes on top. Absent if the uncertainty of the links is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_std_mm: Option<Vec<f64>>,
    /// For Cartesian targets: the pose to give a controller that takes poses, so that its tool comes to the target. In the frame of the targets;
    /// for targets in the measuring frame, which the controller does not know, in the robot's base frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<Vec<ToolPose>>,
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
        self.position_std_mm = joined(self.position_std_mm.take(), next.position_std_mm);
        self.poses = joined(self.poses.take(), next.poses);
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
        for (pointer, n) in [
            ("/q_deg", self.q_deg.len()),
            ("/targets", self.targets.len()),
        ] {
            if n > MAX_TARGETS_PER_REQUEST {
                let detail = format!(
                    "{n} targets; at most {MAX_TARGETS_PER_REQUEST}: send a long program in parts"
                );
                checker.note(pointer, "wrong_length", detail);
            }
        }
        if !self.q_deg.is_empty() && !self.targets.is_empty() {
            checker.note(
                "/targets",
                "q_deg_and_targets",
                "targets are either joint values (q_deg) or Cartesian (targets): send them in two requests",
            );
        }
        if self.frame.is_some() && self.targets.is_empty() && !self.q_deg.is_empty() {
            checker.note(
                "/frame",
                "frame_of_joint_values",
                "joint values have no frame: leave it out, or give Cartesian targets",
            );
        }
        for (i, target) in self
            .targets
            .iter()
            .take(MAX_TARGETS_PER_REQUEST)
            .enumerate()
        {
            target.note_faults(&mut checker, i, n_joints, self.mode);
        }
        for (i, pose) in self.q_deg.iter().take(MAX_TARGETS_PER_REQUEST).enumerate() {
            check_pose(&mut checker, i, pose, n_joints);
        }
        if self.tool_name.is_some() && self.tool.is_some() {
            checker.note("/tool", "two_tools", "give tool or tool_name, not both");
        }
        if self.target.is_some() && (self.tool.is_some() || self.tool_name.is_some()) {
            checker.note(
                if self.tool.is_some() {
                    "/tool"
                } else {
                    "/tool_name"
                },
                "target_and_tool",
                "the tool is either a reflector (target) or a tool centre point (tool): give one",
            );
        }
        for (pointer, name) in [("/frame", &self.frame), ("/tool_name", &self.tool_name)] {
            if let Some(name) = name {
                checker.text(pointer, name, MAX_NAME);
            }
        }
        if let Some(tool) = &self.tool {
            tool.note_faults("/tool", &mut checker);
        }
        if let Some(payload) = &self.payload {
            payload.check("/payload", &mut checker);
        }
        checker.finish("invalid_poses")
    }
}

impl CartesianTarget {
    fn note_faults(&self, checker: &mut Checker, i: usize, n_joints: usize, mode: Mode) {
        let at = format!("/targets/{i}");
        let position = format!("{at}/position_mm");
        check_lengths(checker, &position, &self.position_mm, MAX_TARGET_MM);
        check_rotation(checker, &at, self.quaternion, self.rotation);
        if mode == Mode::Pose && self.quaternion.is_none() && self.rotation.is_none() {
            let detail = "mode pose needs the tool's orientation, as quaternion or rotation; with mode position only the position counts";
            checker.note(format!("{at}/quaternion"), "missing", detail);
        }
        check_joints(
            checker,
            &format!("{at}/q_near_deg"),
            &self.q_near_deg,
            n_joints,
        );
    }
}

impl From<&CartesianTarget> for IsometryMatrix3<f64> {
    fn from(target: &CartesianTarget) -> Self {
        Self::from_parts(
            Translation3::from(Vector3::from(target.position_mm)),
            rotation(target.quaternion, target.rotation),
        )
    }
}

impl From<&IsometryMatrix3<f64>> for ToolPose {
    fn from(t: &IsometryMatrix3<f64>) -> Self {
        Self {
            position_mm: t.translation.vector.into(),
            quaternion: quaternion(&t.rotation),
        }
    }
}

/// Both parts of a long program, if both have the values.
fn joined<T>(first: Option<Vec<T>>, next: Option<Vec<T>>) -> Option<Vec<T>> {
    let (mut all, next) = first.zip(next)?;
    all.extend(next);
    Some(all)
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
            position_std_mm: None,
            poses: None,
            left_out: LeftOut::default(),
            warnings: vec![],
        }
    }
}
