//! The target's distance along the flange axis, from a sweep of the second last joint [Gao 2018, section 2.2].

use crate::frames::error::Error;
use crate::frames::sweep::Sweep;
use crate::kinematics::Robot;

/// z_t of a target on the flange axis. A sweep of joint n-1 draws a circle of radius² = a_n² + sin²(alpha_n)·(d_n + z_t)². For the paper's robot (a_6
/// = 0, alpha_6 = −90°), the radius is z_t + d_6.
///
/// # Errors
/// [`Error::ToolNotVisible`] if that circle does not determine z_t (axes n-1 and n parallel, or a radius below a_n).
pub fn z_tool_mm(robot: &Robot, sweep: &Sweep) -> Result<f64, Error> {
    let last = &robot.links[robot.links.len() - 1];
    let sine = libm::sin(last.alpha_rad).abs();
    let square = sweep.circle.radius_mm * sweep.circle.radius_mm - last.a_mm * last.a_mm;
    if sine < crate::frames::base_frame::MIN_SINE || square <= 0.0 {
        return Err(Error::ToolNotVisible {
            joint: sweep.circle.joint,
        });
    }
    let reach = square.sqrt() / sine;
    Ok(if last.d_mm < 0.0 {
        -reach - last.d_mm
    } else {
        reach - last.d_mm
    })
}
