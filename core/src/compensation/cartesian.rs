//! Cartesian targets: the joint values that reach a pose, near given joint values.
//!
//! A controller that receives a pose computes the joint values of the nominal robot. These joint values are therefore computed first and
//! then corrected like any other target.

use crate::compensation::mode::{Mode, Status};
use crate::compensation::targets::{Compensation, Corrected, Tool};
use crate::kinematics::Robot;
use nalgebra::{DVector, IsometryMatrix3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Maximum number of solutions in one search. Each moves a joint by at most 10°, so this number covers a full turn.
const MAX_SOLUTIONS: usize = 36;
/// The iteration ends when a solution moves no joint by more than this, rad.
const STEP_RAD: f64 = 1e-10;
/// If a joint is further away than this, other solutions are tried, and a remaining distance is reported. Below it, neither a flipped wrist
/// nor a full turn can be nearer.
const FAR_RAD: f64 = FRAC_PI_2;

/// A corrected Cartesian target.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedPose {
    /// The controller's joint values with which the nominal robot has its tool at the target, rad. The controller would compute them itself.
    pub q_nominal_rad: Vec<f64>,
    /// True if one of them is more than 90° away from the requested joint values.
    pub is_far: bool,
    /// The corrected joint values. `position_error_before_mm` is that of the nominal joint values.
    pub corrected: Corrected,
}

impl Compensation<'_> {
    /// Joint values with which the robot has its tool at `t_base_tool`, mm, in the anchored base frame. If several postures reach it, the result is
    /// the nearest one to `q_near_rad`, the controller's joint values, among those found. A search that starts near a wrist singularity may end with
    /// the wrist flipped, so the flipped wrist is tried as well.
    pub fn reach(
        &self,
        t_base_tool: &IsometryMatrix3<f64>,
        q_near_rad: &[f64],
        tool: &Tool,
        mode: Mode,
    ) -> CorrectedPose {
        let t_flange_tool = self.t_flange_tool(tool);
        let nominal = Compensation::new(self.nominal, &self.nominal.links);
        let solve = |q_rad: &[f64]| nominal.solve_towards(q_rad, *t_base_tool, t_flange_tool, mode);
        let mut nearest = search(q_near_rad, solve);
        if nearest.status == Status::Ok
            && apart_rad(&nearest.q_controller_rad, q_near_rad) > FAR_RAD
        {
            for start in other_starts(self.nominal, &nearest.q_controller_rad, q_near_rad) {
                let other = solve(&start);
                let distance_rad = |of: &Corrected| apart_rad(&of.q_controller_rad, q_near_rad);
                if other.status == Status::Ok && distance_rad(&other) < distance_rad(&nearest) {
                    nearest = other;
                }
            }
        }
        let q_nominal_rad = nearest.q_controller_rad;
        CorrectedPose {
            is_far: apart_rad(&q_nominal_rad, q_near_rad) > FAR_RAD,
            corrected: self.solve_towards(&q_nominal_rad, *t_base_tool, t_flange_tool, mode),
            q_nominal_rad,
        }
    }
}

/// Repeats `solve` from the last solution until the target is reached or nothing moves.
fn search(q_near_rad: &[f64], solve: impl Fn(&[f64]) -> Corrected) -> Corrected {
    let mut solved = solve(q_near_rad);
    let mut step_rad = apart_rad(&solved.q_controller_rad, q_near_rad);
    for _ in 1..MAX_SOLUTIONS {
        if solved.status == Status::Ok || step_rad < STEP_RAD {
            break;
        }
        let next = solve(&solved.q_controller_rad);
        step_rad = apart_rad(&next.q_controller_rad, &solved.q_controller_rad);
        solved = next;
    }
    solved
}

/// Starts of further searches: the solution, and the one with the wrist flipped: θ of the last three joints + 180°, negated, and + 180°.
/// Both are without full turns relative to `q_near_rad`. The second one is exact for a wrist of three axes at right angles; for other
/// wrists it is just another start.
fn other_starts(robot: &Robot, q_rad: &[f64], q_near_rad: &[f64]) -> Vec<Vec<f64>> {
    let mut starts = vec![q_rad.to_vec()];
    let n = q_rad.len();
    if let (Some(first), Some(by_model)) = (n.checked_sub(3), robot.joint_rates().try_inverse()) {
        let theta_rad =
            robot.q_model_rad(q_rad)[first + 1] + robot.links[first + 1].theta_offset_rad;
        let mut flip_rad = DVector::zeros(n);
        flip_rad
            .rows_mut(first, 3)
            .copy_from_slice(&[PI, -2.0 * theta_rad, PI]);
        let flip_rad = by_model * flip_rad;
        starts.push(q_rad.iter().zip(&flip_rad).map(|(q, by)| q + by).collect());
    }
    for (q, near) in starts.iter_mut().flat_map(|q| q.iter_mut().zip(q_near_rad)) {
        *q -= TAU * ((*q - near) / TAU).round();
    }
    starts
}

/// The largest distance of a joint, rad.
fn apart_rad(a: &[f64], b: &[f64]) -> f64 {
    let distances = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    distances.fold(0.0, f64::max)
}
