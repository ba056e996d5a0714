//! Positions of the reflectors on the flange.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One reflector on the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Target {
    /// 0-based.
    pub target: usize,
    /// Segment of the measurement, if the target moved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<u32>,
    /// In the flange frame, mm.
    pub position_mm: [f64; 3],
}

/// Offset of a target among `targets`: in this segment, else in the last one.
pub(super) fn target_position(
    targets: &[Target],
    target: usize,
    segment: Option<u32>,
) -> Option<Vector3<f64>> {
    let mut of_target = targets.iter().filter(|t| t.target == target);
    match segment {
        Some(segment) => of_target.find(|t| t.segment.unwrap_or(0) == segment),
        None => of_target.max_by_key(|t| t.segment),
    }
    .map(|t| Vector3::from(t.position_mm))
}
