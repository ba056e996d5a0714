//! Checks exports: compares the poses of a robot that was read back from an exported text with those of the intended robot.

use super::Error;
use crate::exchange::Chain;
use crate::exchange::universal_robots::UrBase;
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::{Link, Robot, t_base_flange};
use crate::operations::urdf::Urdf;
use nalgebra::IsometryMatrix3;

/// Number of configurations that are compared.
const N_CONFIGURATIONS: usize = 100;
/// Seed of these configurations.
const SEED: u64 = 1;
/// Largest allowed difference of positions, mm.
pub const SAME_MM: f64 = 1e-9;
/// Largest allowed difference of the entries of rotation matrices. This corresponds to 1e-9 mm at a distance of one metre.
const SAME_ROTATION: f64 = 1e-12;

/// Compares links that were read back with the intended links.
pub fn same_links(
    format: &'static str,
    robot: &Robot,
    intended: &[Link],
    back: &[Link],
) -> Result<(), Error> {
    if intended.len() != back.len() {
        return Err(Error::ReadBack {
            format,
            cause: format!("{} links became {}", intended.len(), back.len()),
        });
    }
    same_poses(format, robot, intended, &|q| t_base_flange(back, q))
}

/// Compares flange poses. `back` is a function of the model's joint values.
pub fn same_poses(
    format: &'static str,
    robot: &Robot,
    intended: &[Link],
    back: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
) -> Result<(), Error> {
    let as_model = |q_controller: &[f64]| back(&robot.q_model_rad(q_controller));
    same_at_controller(format, robot, intended, &as_model)
}

/// Compares flange poses. `back` is a function of the controller's joint values.
pub fn same_at_controller(
    format: &'static str,
    robot: &Robot,
    intended: &[Link],
    back: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
) -> Result<(), Error> {
    for q in random_configurations(robot, N_CONFIGURATIONS, SEED) {
        let (a, b) = (t_base_flange(intended, &robot.q_model_rad(&q)), back(&q));
        let mm = (a.translation.vector - b.translation.vector).norm();
        let turn = (a.rotation.matrix() - b.rotation.matrix()).amax();
        if !(mm <= SAME_MM && turn <= SAME_ROTATION) {
            return Err(Error::ReadBack {
                format,
                cause: format!("the flange is {mm:.1e} mm and {turn:.1e} rad away at {q:?} rad"),
            });
        }
    }
    Ok(())
}

/// Compares a description of Universal Robots at the controller's joint values. Its last frame may have any pose relative to the flange, but the same
/// pose in all configurations.
pub fn same_description(
    robot: &Robot,
    intended: &[Link],
    back: &Chain,
    base: UrBase,
) -> Result<(), Error> {
    let described = |q: &[f64]| base.t_inertia_links().inverse() * back.t_root_tip(q);
    let zero = vec![0.0; intended.len()];
    let t_tip_flange =
        described(&zero).inverse() * t_base_flange(intended, &robot.q_model_rad(&zero));
    same_at_controller("ur_kinematics", robot, intended, &|q| {
        described(q) * t_tip_flange
    })
}

/// Compares a URDF that `urdf::written_text` wrote. Its joint values are those of the controller, or those of the model if the joint map couples
/// joints.
pub fn same_chain(
    format: &'static str,
    robot: &Robot,
    intended: &[Link],
    text: &[u8],
) -> Result<(), Error> {
    let urdf = Urdf::parse(text)?;
    let flange = format!("link_{}", intended.len());
    let chain = urdf.chain(Some(&flange), Some(intended.len()))?.chain;
    if robot
        .joint_map
        .as_ref()
        .is_some_and(|map| !map.coupling.is_identity(0.0))
    {
        return same_poses(format, robot, intended, &|q| chain.t_root_tip(q));
    }
    same_at_controller(format, robot, intended, &|q| chain.t_root_tip(q))
}
