//! A pose as x, y, z and roll, pitch, yaw: R = Rz(yaw)·Ry(pitch)·Rx(roll), as in a URDF.

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

/// x, y, z in mm and roll, pitch, yaw in rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Origin {
    /// x, y, z, mm.
    pub xyz_mm: [f64; 3],
    /// About x, then y, then z of the fixed frame, rad.
    pub rpy_rad: [f64; 3],
}

/// The pose of an origin.
pub fn pose_of(origin: &Origin) -> IsometryMatrix3<f64> {
    let [roll, pitch, yaw] = origin.rpy_rad;
    let rotation = about(2, yaw) * about(1, pitch) * about(0, roll);
    IsometryMatrix3::from_parts(
        Translation3::from(Vector3::from(origin.xyz_mm)),
        Rotation3::from_matrix_unchecked(rotation),
    )
}

/// The origin of a pose. At a pitch of ±90°, roll and yaw rotate about the same axis. Roll is then determined by rounding, and yaw is computed from
/// the remaining rotation, so that the product is correct.
pub fn origin_of(pose: &IsometryMatrix3<f64>) -> Origin {
    let r = pose.rotation.matrix();
    let across = (r[(2, 1)] * r[(2, 1)] + r[(2, 2)] * r[(2, 2)]).sqrt();
    let roll = if across > 0.0 {
        libm::atan2(r[(2, 1)], r[(2, 2)])
    } else {
        0.0
    };
    let pitch = libm::atan2(-r[(2, 0)], across);
    let rest = r * about(0, -roll) * about(1, -pitch);
    let yaw = libm::atan2(rest[(1, 0)], rest[(0, 0)]);
    Origin {
        xyz_mm: pose.translation.vector.into(),
        rpy_rad: [roll, pitch, yaw],
    }
}

fn about(axis: usize, angle_rad: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle_rad);
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = Matrix3::identity();
    (m[(j, j)], m[(j, k)], m[(k, j)], m[(k, k)]) = (c, -s, s, c);
    m
}
