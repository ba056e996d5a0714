//! The nominal pose of a posture, to be compared with the pendant.

use crate::kinematics::model::MAX_LINKS;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::measurement::MAX_JOINT_VALUE_DEG;
use crate::wire::tool::ToolBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Farthest position on a pendant, mm: further than any arm on a track reaches.
pub(super) const MAX_POSITION_MM: f64 = 100_000.0;

/// A posture, as the pendant shows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PostureBody {
    /// The controller's joint values, degrees.
    #[schema(min_items = 1, max_items = 12)]
    pub q_deg: Vec<f64>,
    /// The active tool; default: none, the flange.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolBody>,
    /// The position that the pendant shows in the base frame, mm: then the answer says how far it is from the model's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown_position_mm: Option<[f64; 3]>,
}

/// The tool's pose in the base frame of the robot's nominal links.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PostureAnswer {
    /// Position, mm.
    pub position_mm: [f64; 3],
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
    /// w, x, y, z with w not negative: q1 to q4 of ABB.
    pub quaternion: [f64; 4],
    /// A, B, C of KUKA: about z, then the new y, then the new x, degrees.
    pub kuka_abc_deg: [f64; 3],
    /// W, P, R of FANUC: about x, then y, then z of the base, degrees. Yaskawa's Rx, Ry, Rz are the same.
    pub fanuc_wpr_deg: [f64; 3],
    /// Rotation vector of Universal Robots, rad.
    pub ur_rotation_vector_rad: [f64; 3],
    /// True if the second angle is within 0.001° of ±90°: then only the sum or the difference of the others is determined, and they are
    /// given with no turn about z.
    pub angles_not_unique: bool,
    /// The model's joint values, degrees: the controller's through the joint map.
    pub q_model_deg: Vec<f64>,
    /// Joints that are outside their limits, counted from 1.
    pub outside_limits: Vec<usize>,
    /// Distance from the position on the pendant, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_apart_mm: Option<f64>,
}

impl PostureBody {
    /// Checks that need only the request and the number of joints.
    ///
    /// # Errors
    /// [`Invalid`] with a JSON pointer to everything that is wrong.
    pub fn check(&self, n_joints: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.length(
            "/q_deg",
            self.q_deg.len(),
            n_joints,
            "one joint value per link of the robot",
        );
        for (i, q) in self.q_deg.iter().take(MAX_LINKS).enumerate() {
            let hint = "joint values are in degrees";
            checker.magnitude(format!("/q_deg/{i}"), *q, MAX_JOINT_VALUE_DEG, hint);
        }
        if let Some(tool) = &self.tool {
            tool.note_faults("/tool", &mut checker);
        }
        if let Some(shown) = &self.shown_position_mm {
            for (i, mm) in shown.iter().enumerate() {
                let hint = "positions are in millimetres";
                let pointer = format!("/shown_position_mm/{i}");
                checker.magnitude(pointer, *mm, MAX_POSITION_MM, hint);
            }
        }
        checker.finish("invalid_posture")
    }
}
