//! The nominal tool pose for given joint values, for comparison with the display of the teach pendant.

use crate::measurement::RotationConvention;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::point::check_joints;
use crate::wire::robot::MAX_ANGLE_DEG;
use crate::wire::tool::{ToolBody, check_lengths, check_rotation, rotation};
use nalgebra::{Rotation3, Vector3};
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
    /// The orientation that the pendant displays in the base frame. If it is given, the answer contains its angle from the orientation of the model, and
    /// the last joint is compared, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown_orientation: Option<ShownOrientation>,
}

/// An orientation as a pendant displays it: exactly one of these fields, which are those of the answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShownOrientation {
    /// A, B, C of KUKA, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kuka_abc_deg: Option<[f64; 3]>,
    /// W, P, R of FANUC or Rx, Ry, Rz of Yaskawa, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fanuc_wpr_deg: Option<[f64; 3]>,
    /// Rotation vector of Universal Robots, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ur_rotation_vector_rad: Option<[f64; 3]>,
    /// w, x, y, z: q1 to q4 of ABB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
}

impl ShownOrientation {
    /// The rotation of the field that is given.
    pub fn rotation(&self) -> Rotation3<f64> {
        let sequence = |axes, is_extrinsic, angles_deg: [f64; 3]| {
            let convention = RotationConvention::Sequence { axes, is_extrinsic };
            convention.rotation(&Vector3::from(angles_deg.map(f64::to_radians)))
        };
        if let Some([a, b, c]) = self.kuka_abc_deg {
            return sequence([2, 1, 0], false, [c, b, a]);
        }
        if let Some(wpr) = self.fanuc_wpr_deg {
            return sequence([0, 1, 2], true, wpr);
        }
        if let Some(vector) = self.ur_rotation_vector_rad {
            return RotationConvention::RotationVector.rotation(&vector.into());
        }
        rotation(self.quaternion, None)
    }

    fn check_into(&self, at: &str, checker: &mut Checker) {
        let (degrees, radians) = ("angles are in degrees", "a rotation vector is in radians");
        let angles = [
            ("kuka_abc_deg", self.kuka_abc_deg, MAX_ANGLE_DEG, degrees),
            ("fanuc_wpr_deg", self.fanuc_wpr_deg, MAX_ANGLE_DEG, degrees),
            (
                "ur_rotation_vector_rad",
                self.ur_rotation_vector_rad,
                MAX_ANGLE_DEG.to_radians(),
                radians,
            ),
        ];
        let mut n_given = usize::from(self.quaternion.is_some());
        for (name, angles, limit, hint) in angles {
            let Some(angles) = angles else { continue };
            n_given += 1;
            checker.magnitudes(&format!("{at}/{name}"), &angles, limit, hint);
        }
        if n_given != 1 {
            let detail = "give the orientation in one form: kuka_abc_deg, fanuc_wpr_deg, ur_rotation_vector_rad or quaternion";
            checker.add(at, "not_one_orientation", detail);
        }
        check_rotation(checker, at, self.quaternion, None);
    }
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
    /// Angle between the model's orientation and the orientation on the pendant, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_apart_deg: Option<f64>,
    /// Numbers of the joints, counted from 1, that the comparison with the pendant does not check: half a turn of them moves the shown position by less
    /// than robots of one type may differ, 2 % of its distance from the base. Often this is the last joint. With `shown_orientation` all are checked.
    #[serde(default)]
    pub unchecked_joints: Vec<usize>,
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
        if let Some(shown) = &self.shown_orientation {
            shown.check_into("/shown_orientation", &mut checker);
        }
        checker.finish("invalid_posture")
    }
}
