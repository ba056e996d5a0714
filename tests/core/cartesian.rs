//! Joint values of Cartesian targets: the posture near given joint values, and targets out of reach.

use crate::data::paper_robot;
use crate::simulation::Normal;
use kincal::compensation::{Compensation, Mode, Status, Tool};
use kincal::kinematics::rotation::rotation_log;
use kincal::kinematics::{JointMap, Robot};
use nalgebra::{DMatrix, IsometryMatrix3, Rotation3, Vector3};
use rand::RngExt;
use std::f64::consts::PI;

/// The paper's arm, and one with a joint map that couples its wrist: joint values 10° off in each joint, among them on the other side of a wrist
/// singularity.
#[test]
fn the_posture_is_the_nearest_one() {
    let mut coupling = DMatrix::identity(6, 6);
    coupling[(5, 4)] = 1.0;
    let map = JointMap {
        sign: vec![1.0, 1.0, -1.0, 1.0, -1.0, 1.0],
        offset_rad: vec![0.0, -0.2, 0.1, 0.0, 0.05, 0.3],
        coupling,
    };
    let tool = Tool::Tcp(IsometryMatrix3::translation(0.0, 0.0, 100.0));
    let limits_deg = [150.0, 60.0, 60.0, 150.0, 100.0, 170.0];
    for joint_map in [None, Some(map)] {
        let nominal = Robot {
            joint_map,
            ..paper_robot()
        };
        let compensation = Compensation::new(&nominal, &nominal.links);
        let mut random = Normal::new(24);
        let mut targets = vec![[-18.1f64, -58.5, -24.6, 34.4, 4.9, -121.1]];
        targets.extend((1..200).map(|_| {
            let mut q = limits_deg.map(|limit| random.0.random_range(-limit..limit));
            q[1] -= 50.0;
            q
        }));
        let (mut n_ok, mut n_far, mut n_flipped) = (0, 0, 0);
        for (i, q_deg) in targets.iter().enumerate() {
            let q = q_deg.map(f64::to_radians);
            let near = q.map(|q| {
                let is_up = i > 0 && random.0.random::<bool>();
                q + if is_up { 10f64 } else { -10.0 }.to_radians()
            });
            let wanted = compensation.t_nominal_tool(&q, &tool);
            let reached = compensation.reach(&wanted, &near, &tool, Mode::Pose);
            let found = reached.q_nominal_rad.iter().zip(&near);
            let turn_deg = found
                .fold(0.0f64, |turn, (a, b)| turn.max((a - b).abs()))
                .to_degrees();
            assert_eq!(reached.is_far, turn_deg > 90.0);
            if reached.corrected.status == Status::Ok {
                n_ok += 1;
                n_far += usize::from(reached.is_far);
                n_flipped += usize::from(turn_deg > 60.0 && !reached.is_far);
                assert!(
                    i > 0 || turn_deg < 10.01,
                    "{turn_deg}° in the tester's example"
                );
            }
        }
        println!(
            "of 200 targets {n_ok} ok, {n_far} of them far from near joint values and said to be"
        );
        assert!(
            n_ok >= 199 && n_far <= 1 && n_flipped == 0,
            "{n_ok} {n_far} {n_flipped}"
        );
    }
}

/// The paper's arm with a tool, at joint values that are not singular.
fn arm_with_tool(nominal: &Robot) -> (Compensation<'_>, Tool, [f64; 6]) {
    let compensation = Compensation::new(nominal, &nominal.links);
    let tool = Tool::Tcp(IsometryMatrix3::translation(0.0, 0.0, 100.0));
    (compensation, tool, [0.1, -0.5, 0.3, 0.2, 0.4, -0.3])
}

/// The rotation matrix of a half turn is symmetric, as that of no turn.
#[test]
fn a_tool_that_points_the_other_way_is_not_at_its_target() {
    let nominal = paper_robot();
    let (compensation, tool, near) = arm_with_tool(&nominal);
    let at = compensation.t_nominal_tool(&near, &tool);
    for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
        let half_turn = Rotation3::from_axis_angle(&axis, PI);
        assert!((rotation_log(&half_turn).norm() - PI).abs() < 1e-9);
        let wanted = at * half_turn;
        let reached = compensation.reach(&wanted, &near, &tool, Mode::Pose);
        let is = compensation.t_nominal_tool(&reached.q_nominal_rad, &tool);
        let apart_rad = is.rotation.angle_to(&wanted.rotation);
        let status = reached.corrected.status;
        println!("about {axis:?}: {status:?}, {apart_rad:.6} rad apart");
        assert_eq!(status == Status::Ok, apart_rad < 1e-6);
        // Joint 6 turns by 180°.
        assert!(axis != Vector3::z_axis() || status == Status::Ok);
    }
}

#[test]
fn a_target_out_of_reach_is_not_reached() {
    let nominal = paper_robot();
    let (compensation, tool, near) = arm_with_tool(&nominal);
    for mode in [Mode::Pose, Mode::Position] {
        let wanted = IsometryMatrix3::translation(5000.0, 0.0, 500.0);
        let reached = compensation.reach(&wanted, &near, &tool, mode).corrected;
        println!("{mode:?}: {:.0} mm left", reached.position_error_after_mm);
        assert_eq!(reached.status, Status::NotReached, "{reached:?}");
        assert!(reached.position_error_after_mm > 3000.0);
    }
}
