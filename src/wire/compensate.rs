//! Compensation: request and answer with corrected joint targets.

pub use crate::compensation::{Base, Mode, Status};
use crate::wire::corrections::PayloadBody;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::measurement::Warning;
use crate::wire::point::check_joints;
use crate::wire::robot::MAX_NAME;
use crate::wire::tool::{ToolBody, check_lengths, check_rotation, quaternion, rotation};
use nalgebra::{IsometryMatrix3, Translation3, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of targets of one request. They take some seconds on one core.
pub const MAX_TARGETS_PER_REQUEST: usize = 20_000;
/// Largest absolute coordinate of a Cartesian target, mm.
pub(super) const MAX_TARGET_MM: f64 = 100_000.0;
/// Frames that every robot has for its targets: the base frame and the measuring frame.
pub const OWN_FRAMES: [&str; 2] = ["base", "measuring"];

/// Targets to correct: either `q_deg` or `targets`. The targets must have been programmed offline, because taught targets already contain the robot's
/// errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CompensateBody {
    /// The controller's joint values of each target, degrees.
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
    /// Use this identified target as the tool, 0-based. A target that was measured as a pose has its own orientation, a reflector that of the flange.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(maximum = 31)]
    pub target: Option<usize>,
    /// The tool centre point, instead of a reflector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolBody>,
    /// The name of a stored tool of the robot, instead of `tool`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub tool_name: Option<String>,
    /// Whether the tool's pose is corrected, or only its position.
    #[serde(default)]
    pub mode: Mode,
    /// The base frame in which the corrected targets are exact. Default: `measured` if positions were measured in the base frame, otherwise `robot`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<Base>,
    /// Payload at these targets; default: the payload during the identification. The payload has no effect if the parameter set has no corrections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<PayloadBody>,
}

/// A Cartesian target: the pose of the tool, and joint values near the solution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CartesianTarget {
    /// Position of the tool in `frame`, mm.
    pub position_mm: [f64; 3],
    /// Orientation of the tool in `frame`: w, x, y, z. Mode `pose` needs either `quaternion` or `rotation`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
    /// Orientation of the tool in `frame`: a rotation matrix, row by row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
    /// The controller's joint values near the target, degrees. They select the posture (elbow, wrist): the nearest one that is found.
    pub q_near_deg: Vec<f64>,
}

/// A pose of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ToolPose {
    /// mm.
    pub position_mm: [f64; 3],
    /// w, x, y, z with w ≥ 0.
    pub quaternion: [f64; 4],
}

/// The frame of position and orientation errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorFrame {
    /// The measuring frame, with `base: measured`.
    Measuring,
    /// The robot's own base frame, with `base: robot`.
    #[default]
    RobotBase,
}

/// Corrected targets, in the order of the request.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CompensateAnswer {
    /// Corrected joint values for the controller, degrees. With them the tool of the real robot is where the tool of the nominal robot would be.
    pub q_deg: Vec<Vec<f64>>,
    /// The frame of the errors below. Answers of older versions do not have this field; for them the frame is `robot_base`.
    #[serde(default)]
    pub frame: ErrorFrame,
    /// Position error of the tool with the requested joint values, mm.
    pub position_error_before_mm: Vec<f64>,
    /// Remaining position error of the tool with the corrected joint values, computed with the identified robot, mm.
    pub position_error_after_mm: Vec<f64>,
    /// Remaining orientation error of the tool with the corrected joint values, degrees.
    pub orientation_error_after_deg: Vec<f64>,
    /// Status of each target.
    pub status: Vec<Status>,
    /// True if the corrected target is outside the measured region. There the corrections fade out, and only the link parameters remain. Always false
    /// without corrections.
    pub extrapolated: Vec<bool>,
    /// Standard uncertainty of the tool's position with the corrected joint values, in `frame`, mm (3-D: root of the sum of the three variances). It
    /// contains the uncertainty of the identified links and corrections, of the work frame, and that of a tool. For a tool
    /// from a drawing, and for a measured reflector in the measuring frame, it contains the usual errors of `theta_offset` and `d` of the last link, which
    /// measured positions do not show. For a tool that was measured with this robot, give its `std_mm` instead. It does not contain the robot's repeatability, nor the values of `left_out`. Absent if the uncertainty
    /// of the links is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_std_mm: Option<Vec<f64>>,
    /// For Cartesian targets: corrected poses, for a controller that is programmed with poses instead of joint values. They are in the frame of the
    /// targets, also in a work frame with `reference: measuring`. Only for targets with `frame: measuring` they are in the robot's base frame, because
    /// the controller does not know the measuring frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<Vec<ToolPose>>,
    /// Identified errors that are not corrected.
    #[serde(default)]
    pub left_out: LeftOut,
    /// Warnings. `set_withdrawn`: the parameter set was withdrawn. `check_robot`: a session did not fit the robot, which may have changed.
    /// `pose_not_seen`: the measured positions do not determine the flange's pose completely, and this tool or mode depends on the part that is not
    /// determined. `reflector_length`: the model assumes the reflector at the flange, so an error of d of the last link looks like a reflector in front
    /// of the flange. `far_from_q_near`: in the Cartesian targets `rows` (0-based), the nearest posture that was found has a joint more than 90° from
    /// `q_near_deg`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

/// Identified errors that are not corrected, because they are treated as part of the pose of base and tool.
///
/// With `base: robot` these are all errors of link 1 (also a wrong mastering of joint 1), and `theta_offset` and `d` of the last link. With `base:
/// measured` the base is corrected, and the values of the base are 0. For the last link, `theta_offset` is not corrected; `d` is not corrected if it
/// changed by more than three times the usual error of a link: it then contains a tool's length.
///
/// Corrected targets are exact in a base frame and on a flange that have moved by these values. So measure the work object and the tool with this
/// robot, or add these values to them. All values are 0 if the set was identified in the frame of an instrument, because such a set cannot determine
/// them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeftOut {
    /// Rotation of the base frame relative to the nominal one, degrees. A wrong mastering of joint 1 rotates the base about the axis of joint 1.
    pub base_turn_deg: f64,
    /// Shift of the base frame relative to the nominal one, mm.
    pub base_shift_mm: f64,
    /// Rotation of the flange about the last axis, degrees.
    pub flange_turn_deg: f64,
    /// Shift of the flange along the last axis, mm.
    pub flange_shift_mm: f64,
}

impl CompensateAnswer {
    /// Appends the answer for the next part of a long program. `left_out` depends only on the parameter set, so it is the same for each part.
    pub fn extend(&mut self, next: Self) {
        self.add_warnings(next.warnings);
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
    }

    /// Adds the warnings of the next part; a warning that both parts have gets the rows of both.
    fn add_warnings(&mut self, of_next: Vec<Warning>) {
        let n = self.q_deg.len();
        for mut warning in of_next {
            warning.rows.iter_mut().for_each(|row| *row += n);
            let is_same = |known: &&mut Warning| {
                (&known.code, &known.detail) == (&warning.code, &warning.detail)
            };
            match self.warnings.iter_mut().find(is_same) {
                Some(known) => known.rows.extend(warning.rows),
                None => self.warnings.push(warning),
            }
        }
    }
}

impl CompensateBody {
    /// Makes all checks that need only the request and the number of joints.
    pub fn check(&self, n_joints: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        for (pointer, n) in [
            ("/q_deg", self.q_deg.len()),
            ("/targets", self.targets.len()),
        ] {
            let what = "targets (a long program is sent in parts)";
            checker.count(pointer, n, 0..=MAX_TARGETS_PER_REQUEST, what);
        }
        if !self.q_deg.is_empty() && !self.targets.is_empty() {
            checker.add(
                "/targets",
                "q_deg_and_targets",
                "targets are either joint values (q_deg) or Cartesian (targets): send them in two requests",
            );
        }
        if self.frame.is_some() && self.targets.is_empty() && !self.q_deg.is_empty() {
            checker.add(
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
            target.check_into(&mut checker, i, n_joints, self.mode);
        }
        for (i, pose) in self.q_deg.iter().take(MAX_TARGETS_PER_REQUEST).enumerate() {
            check_joints(&mut checker, &format!("/q_deg/{i}"), pose, n_joints);
        }
        if self.tool_name.is_some() && self.tool.is_some() {
            checker.add("/tool", "two_tools", "give tool or tool_name, not both");
        }
        if self.target.is_some() && (self.tool.is_some() || self.tool_name.is_some()) {
            checker.add(
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
            tool.check_into("/tool", &mut checker);
        }
        if let Some(payload) = &self.payload {
            payload.check("/payload", &mut checker);
        }
        checker.finish("invalid_poses")
    }
}

impl CartesianTarget {
    fn check_into(&self, checker: &mut Checker, i: usize, n_joints: usize, mode: Mode) {
        let at = format!("/targets/{i}");
        let position = format!("{at}/position_mm");
        check_lengths(checker, &position, &self.position_mm, MAX_TARGET_MM);
        check_rotation(checker, &at, self.quaternion, self.rotation);
        if mode == Mode::Pose && self.quaternion.is_none() && self.rotation.is_none() {
            let detail = "mode pose needs the tool's orientation, as quaternion or rotation; with mode position only the position counts";
            checker.add(format!("{at}/quaternion"), "missing", detail);
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

/// Concatenates the values of two parts of a long program; none if one of the parts has no values.
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

/// A corrected program, and what was found for each of its targets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrectedProgram {
    /// The program with corrected targets, in base64. Everything else stays as it was, to the byte; a workbook becomes text with tabs between its
    /// columns.
    pub program_base64: String,
    /// True if the program was a workbook.
    pub is_workbook: bool,
    /// Names of the columns with the joint values, joint 1 first.
    pub joint_columns: Vec<String>,
    /// Names of columns with poses of the joint values before the correction. They stay as they are.
    pub left_columns: Vec<String>,
    /// The line of each target, counted from 1.
    pub lines: Vec<usize>,
    /// Joint values of each target in the program, degrees; of Cartesian targets those near the solution.
    pub program_q_deg: Vec<Vec<f64>>,
    /// The corrected targets, in the order of the program.
    pub corrected: CompensateAnswer,
}
