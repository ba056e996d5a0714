//! Prediction of target positions with an identified robot.

use crate::measurement::csv::MAX_TARGETS;
use crate::wire::corrections::PayloadBody;
use crate::wire::issue::{Checker, Invalid};
use crate::wire::json;
use crate::wire::measurement::Warning;
use crate::wire::point::check_joints;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of poses of one request.
pub const MAX_POSES: usize = 100_000;

/// Poses to predict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictBody {
    /// The controller's joint values of each pose, degrees.
    #[schema(max_items = 100000)]
    #[serde(deserialize_with = "json::at_most::<_, _, { 2 * MAX_POSES }>")]
    pub q_deg: Vec<Vec<f64>>,
    /// Number of the reflector, 0-based.
    #[serde(default)]
    #[schema(maximum = 31)]
    pub target: usize,
    /// Segment of the measurement, for a target that moved; default: the last segment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<u32>,
    /// Payload at these poses; default: the payload during the identification. The payload has no effect if the parameter set has no corrections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<PayloadBody>,
}

/// Predicted positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PredictAnswer {
    /// Position of the target at each pose, in the measuring frame of the parameter set, mm.
    pub position_mm: Vec<[f64; 3]>,
    /// True if the pose is outside the measured region. There the corrections fade out, and only the link parameters remain. Always false without
    /// corrections.
    pub extrapolated: Vec<bool>,
    /// Standard uncertainty of each position, mm (3-D: root of the sum of the three variances). It contains the uncertainty of the identified links,
    /// base, target and corrections. It does not contain the robot's repeatability. Absent if the uncertainty of the links is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_std_mm: Option<Vec<f64>>,
    /// Warnings. `set_withdrawn`: the parameter set was withdrawn. `check_robot`: a session did not fit the robot, which may have changed. `no_fit`,
    /// `joint_map_suspect`, `model_too_small`: the set does not fit its robot. `instrument_scale`: the instrument measured lengths wrongly.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

impl PredictBody {
    /// Makes all checks that need only the request and the number of joints.
    pub fn check(&self, n_joints: usize) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        checker.count("/q_deg", self.q_deg.len(), 0..=MAX_POSES, "poses");
        for (i, pose) in self.q_deg.iter().take(MAX_POSES).enumerate() {
            check_joints(&mut checker, &format!("/q_deg/{i}"), pose, n_joints);
        }
        let what = "targets are numbered from 0";
        checker.within("/target", self.target, 0..=MAX_TARGETS - 1, what);
        if let Some(payload) = &self.payload {
            payload.check("/payload", &mut checker);
        }
        checker.finish("invalid_poses")
    }
}

/// Refusal of a target that the parameter set does not have.
pub fn unknown_target() -> Invalid {
    Invalid::at(
        "/target",
        "unknown_target",
        "the parameter set has no such target (or segment); its `targets` lists them",
    )
}
