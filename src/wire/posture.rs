//! The nominal tool pose for given joint values, for comparison with the display of the teach pendant.

use crate::wire::issue::{Checker, Invalid};
use crate::wire::point::check_joints;
use crate::wire::tool::{ToolBody, check_lengths};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Largest absolute coordinate on a pendant, mm. No arm on a linear track reaches that far.
pub(super) const MAX_POSITION_MM: f64 = 100_000.0;

/// A posture as displayed on the teach pendant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PostureBody {
    /// The controller's joint values, degrees.
    #[schema(min_items = 1, max_items = 12)]
    pub q_deg: Vec<f64>,
    /// The active tool; default: no tool, i.e. the flange.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool: Option<ToolBody>,
    /// The position that the pendant displays in the base frame, mm. If it is given, the answer contains its distance from the position of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown_position_mm: Option<[f64; 3]>,
}

/// The pose of the tool in the base frame, computed with the robot's nominal links.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PostureAnswer {
    /// Position, mm.
    pub position_mm: [f64; 3],
    /// Rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
    /// w, x, y, z with w ≥ 0. These are q1 to q4 of ABB.
    pub quaternion: [f64; 4],
    /// A, B, C of KUKA: rotations about z, then about the new y, then about the new x, degrees.
    pub kuka_abc_deg: [f64; 3],
    /// W, P, R of FANUC: rotations about x, then y, then z of the base frame, degrees. Rx, Ry, Rz of Yaskawa are the same angles.
    pub fanuc_wpr_deg: [f64; 3],
    /// Rotation vector of Universal Robots, rad.
    pub ur_rotation_vector_rad: [f64; 3],
    /// True if the second angle is within 0.001° of ±90° (gimbal lock). Then only the sum or the difference of the other two angles is determined,
    /// and the angle about z is given as 0.
    pub angles_not_unique: bool,
    /// The model's joint values, degrees: the controller's joint values after the joint map.
    pub q_model_deg: Vec<f64>,
    /// Numbers of the joints that are outside their limits, counted from 1.
    pub outside_limits: Vec<usize>,
    /// Distance between the model's position and the position on the pendant, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_apart_mm: Option<f64>,
}

impl PostureBody {
    /// Makes all checks that need only the request and the number of joints.
    pub fn check(&self, n_joints: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        check_joints(&mut checker, "/q_deg", &self.q_deg, n_joints);
        if let Some(tool) = &self.tool {
            tool.check_into("/tool", &mut checker);
        }
        if let Some(shown) = &self.shown_position_mm {
            check_lengths(&mut checker, "/shown_position_mm", shown, MAX_POSITION_MM);
        }
        checker.finish("invalid_posture")
    }
}
