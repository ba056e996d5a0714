//! Cartesian targets: the joint values that reach a pose, near given ones.
//!
//! A controller that is told a pose computes the joint values of the nominal robot there. So the nominal robot's joint values come first, then
//! they are corrected as any other target.

use crate::compensation::mode::{Mode, Status};
use crate::compensation::targets::{Compensation, Corrected, Tool};
use nalgebra::IsometryMatrix3;

/// Each solution moves a joint by 10° at most, so this many go once around.
const MAX_SOLUTIONS: usize = 36;
/// A solution that moves no joint by more than this is the last one, rad.
const STEP_RAD: f64 = 1e-10;

/// A corrected Cartesian target.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedPose {
    /// The controller's joint values with which the nominal robot has its tool there, rad: what the controller would take by itself.
    pub q_nominal_rad: Vec<f64>,
    /// What the robot needs. `position_error_before_mm` is that of the nominal joint values.
    pub corrected: Corrected,
}

impl Compensation<'_> {
    /// Joint values with which the robot has its tool at `t_base_tool`, mm, in the anchored base frame: of all postures that reach it, the one
    /// that is found from `q_near_rad`, the controller's joint values.
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
