//! Map from the controller's joint values to those of the model.

use crate::kinematics::JointMap;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// q_model = coupling · (sign ∘ q_controller) + offset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JointMapBody {
    /// +1 or -1 for each joint; default: all +1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sign: Option<Vec<f64>>,
    /// Offset of each joint, added last, degrees; default: all 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_deg: Option<Vec<f64>>,
    /// Invertible matrix of n rows with n values each; default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coupling: Option<Vec<Vec<f64>>>,
}

/// Fills every field, also those with default values. Angles are in degrees.
impl From<&JointMap> for JointMapBody {
    fn from(map: &JointMap) -> Self {
        // Rounds to 1e-9°, to remove the rounding error of the conversion from radians.
        let rounded_deg = |rad: &f64| (rad.to_degrees() * 1e9).round() / 1e9;
        Self {
            sign: Some(map.sign.clone()),
            offset_deg: Some(map.offset_rad.iter().map(rounded_deg).collect()),
            coupling: Some(
                map.coupling
                    .row_iter()
                    .map(|row| row.iter().copied().collect())
                    .collect(),
            ),
        }
    }
}

impl JointMapBody {
    /// The joint map of a robot with `n` joints. The body must have been checked before.
    pub(super) fn joint_map(&self, n: usize) -> JointMap {
        JointMap {
            sign: self.sign.clone().unwrap_or_else(|| vec![1.0; n]),
            offset_rad: self.offset_deg.as_ref().map_or_else(
                || vec![0.0; n],
                |o| o.iter().map(|deg| deg.to_radians()).collect(),
            ),
            coupling: self
                .coupling
                .as_ref()
                .map_or_else(|| DMatrix::identity(n, n), |rows| matrix(rows)),
        }
    }
}

pub(super) fn matrix(rows: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j])
}
