//! Positions of the reflectors on the flange.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
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
    /// How it is turned in the flange frame, where poses were measured: w, x, y, z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<[f64; 4]>,
}

/// How targets are turned, in order from 0: in this segment, else in the last one; none where no pose was measured.
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

/// Offset of a target among `targets`: in this segment, else in the last one.
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
