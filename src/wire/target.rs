//! Positions of the reflectors on the flange.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One reflector on the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Target {
    /// Number of the target, 0-based.
    pub target: usize,
    /// Segment of the measurement, if the target moved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<u32>,
    /// Position in the flange frame, mm.
    pub position_mm: [f64; 3],
    /// Orientation in the flange frame, if poses were measured: w, x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
}

/// Rotations of all targets in the flange frame, in order from 0: each in `segment`, or in the last segment if the target has none there.
/// Empty if no poses were measured.
pub(super) fn target_rotations(targets: &[Target], segment: Option<u32>) -> Vec<Rotation3<f64>> {
    if targets.iter().all(|t| t.quaternion.is_none()) {
        return vec![];
    }
    let n_targets = targets.iter().map(|t| t.target + 1).max().unwrap_or(0);
    let of = |target| {
        let found = of_target(targets, target, segment).or(of_target(targets, target, None));
        let [w, x, y, z] = found
            .and_then(|t| t.quaternion)
            .unwrap_or([1.0, 0.0, 0.0, 0.0]);
        UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix()
    };
    (0..n_targets).map(of).collect()
}

/// Position of a target in the flange frame, in this segment; without `segment`, in the last segment.
pub(super) fn target_position(
    targets: &[Target],
    target: usize,
    segment: Option<u32>,
) -> Option<Vector3<f64>> {
    of_target(targets, target, segment).map(|t| Vector3::from(t.position_mm))
}

fn of_target(targets: &[Target], target: usize, segment: Option<u32>) -> Option<&Target> {
    let mut of_target = targets.iter().filter(|t| t.target == target);
    match segment {
        Some(segment) => of_target.find(|t| t.segment.unwrap_or(0) == segment),
        None => of_target.max_by_key(|t| t.segment),
    }
}
