//! The nominal pose of a posture, with the orientation angles of several manufacturers.

use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Robot, t_base_flange};
use crate::wire::issue::Invalid;
use crate::wire::posture::{PostureAnswer, PostureBody};
use crate::wire::tool::quaternion;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Vector3};
use std::f64::consts::PI;

/// If the cosine of the second angle is below this (within 0.001° of ±90°), the first and the third angle are not unique (gimbal lock).
const NOT_UNIQUE: f64 = 1.745e-5;
/// Tolerance of the joint limits, degrees: a pendant rounds joint values to two decimals.
const ROUNDED_DEG: f64 = 0.01;
/// Largest plausible distance between the flanges of a real robot and of its type, as a share of the flange's distance from the base.
pub const MAX_APART: f64 = 0.02;

/// Computes the pose of the flange or of a tool with the nominal links, in the base frame, for the controller's joint values.
///
/// # Errors
/// [`Invalid`] for joint values or a tool that cannot be used.
pub fn posture(request: &PostureBody, robot: &Robot) -> Result<PostureAnswer, Invalid> {
    request.check(robot.links.len())?;
    let q_rad: Vec<f64> = request.q_deg.iter().map(|deg| deg.to_radians()).collect();
    let q_model_rad = robot.q_model_rad(&q_rad);
    let tool = request.tool;
    let t_flange_tool = tool.map_or_else(IsometryMatrix3::identity, IsometryMatrix3::from);
    let t_at =
        |q_rad: &[f64]| t_base_flange(&robot.links, &robot.q_model_rad(q_rad)) * t_flange_tool;
    let t = t_at(&q_rad);
    let r = t.rotation.matrix();
    let (yaw_pitch_roll, angles_not_unique) = yaw_pitch_roll(r);
    let [yaw, pitch, roll] = yaw_pitch_roll.map(f64::to_degrees);
    let position = t.translation.vector;
    let outside = robot
        .joint_limits_rad
        .iter()
        .zip(&request.q_deg)
        .enumerate()
        .filter(|(_, (limits, q_deg))| {
            limits.is_some_and(|(low, high)| {
                **q_deg < low.to_degrees() - ROUNDED_DEG
                    || **q_deg > high.to_degrees() + ROUNDED_DEG
            })
        });
    Ok(PostureAnswer {
        position_mm: position.into(),
        rotation: [0, 1, 2].map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)]]),
        quaternion: quaternion(&t.rotation),
        kuka_abc_deg: [yaw, pitch, roll],
        fanuc_wpr_deg: [roll, pitch, yaw],
        ur_rotation_vector_rad: rotation_log(&t.rotation).into(),
        angles_not_unique,
        q_model_deg: q_model_rad.iter().map(|rad| rad.to_degrees()).collect(),
        outside_limits: outside.map(|(i, _)| i + 1).collect(),
        position_apart_mm: request
            .shown_position_mm
            .map(|shown| (Vector3::from(shown) - position).norm()),
        orientation_apart_deg: request
            .shown_orientation
            .map(|shown| apart_deg(&shown.rotation(), &t.rotation)),
        unchecked_joints: match (&request.shown_position_mm, &request.shown_orientation) {
            (Some(_), None) => unchecked_joints(&q_rad, &t_at),
            _ => vec![],
        },
    })
}

/// Angle of the rotation between two orientations, from the quaternion, which is accurate for small angles.
fn apart_deg(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    rotation_log(&(a.inverse() * b)).norm().to_degrees()
}

/// Joints, counted from 1, that are not checked: half a turn moves the position by less than [`MAX_APART`] of its distance from the base.
fn unchecked_joints(q_rad: &[f64], t_at: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>) -> Vec<usize> {
    let position = t_at(q_rad).translation.vector;
    let is_unchecked = |joint: &usize| {
        let mut turned = q_rad.to_vec();
        turned[*joint] += PI;
        let moved = (t_at(&turned).translation.vector - position).norm();
        moved < MAX_APART * position.norm()
    };
    let joints = (0..q_rad.len()).filter(is_unchecked);
    joints.map(|joint| joint + 1).collect()
}

/// The angles with R = Rz(yaw)·Ry(pitch)·Rx(roll), rad. Also returns true if yaw and roll are not unique.
fn yaw_pitch_roll(r: &Matrix3<f64>) -> ([f64; 3], bool) {
    let across = libm::sqrt(r[(2, 1)] * r[(2, 1)] + r[(2, 2)] * r[(2, 2)]);
    let pitch = libm::atan2(-r[(2, 0)], across);
    if across < NOT_UNIQUE {
        // With yaw = 0, R = Ry(±90°)·Rx(roll): roll contains the whole rotation.
        let roll = libm::atan2(-r[(1, 2)], r[(1, 1)]);
        return ([0.0, pitch, roll], true);
    }
    let yaw = libm::atan2(r[(1, 0)], r[(0, 0)]);
    ([yaw, pitch, libm::atan2(r[(2, 1)], r[(2, 2)])], false)
}
