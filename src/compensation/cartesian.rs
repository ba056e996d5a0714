//! Cartesian targets: the joint values that reach a pose, near given joint values.
//!
//! A controller that receives a pose computes the joint values of the nominal robot. These are therefore computed first, and are then corrected like
//! any other target.

use crate::compensation::mode::{Mode, Status};
use crate::compensation::targets::{Compensation, Corrected, Tool};
use nalgebra::IsometryMatrix3;

/// Each solution moves a joint by at most 10°, so this many cover a full turn.
const MAX_SOLUTIONS: usize = 36;
/// The iteration ends when a solution moves no joint by more than this, rad.
const STEP_RAD: f64 = 1e-10;

/// A corrected Cartesian target.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedPose {
    /// The controller's joint values with which the nominal robot has its tool at the target, rad. The controller would compute them itself.
    pub q_nominal_rad: Vec<f64>,
    /// The corrected joint values. `position_error_before_mm` is that of the nominal joint values.
    pub corrected: Corrected,
}

impl Compensation<'_> {
    /// Joint values with which the robot has its tool at `t_base_tool`, mm, in the anchored base frame. If several postures reach it, the result is
    /// the one found from `q_near_rad`, the controller's joint values.
    pub fn reach(
        &self,
        t_base_tool: &IsometryMatrix3<f64>,
        q_near_rad: &[f64],
        tool: &Tool,
        mode: Mode,
    ) -> CorrectedPose {
        let t_flange_tool = self.t_flange_tool(tool);
        let nominal = Compensation::new(self.nominal, &self.nominal.links);
        let mut q_nominal_rad = q_near_rad.to_vec();
        for _ in 0..MAX_SOLUTIONS {
            let solved = nominal.towards(&q_nominal_rad, *t_base_tool, t_flange_tool, mode);
            let step = solved
                .q_controller_rad
                .iter()
                .zip(&q_nominal_rad)
                .map(|(to, from)| (to - from).abs())
                .fold(0.0, f64::max);
            q_nominal_rad = solved.q_controller_rad;
            if solved.status == Status::Ok || step < STEP_RAD {
                break;
            }
        }
        CorrectedPose {
            corrected: self.towards(&q_nominal_rad, *t_base_tool, t_flange_tool, mode),
            q_nominal_rad,
        }
    }
}
