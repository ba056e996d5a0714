//! The robot's base in the instrument frame, from the axes of joints 1 and 2 [Gao 2018, section 2.2].

use crate::frames::error::Error;
use crate::frames::sweep::Sweep;
use crate::kinematics::Robot;
use crate::kinematics::forward::t_previous_link;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3};

/// Smallest sine of the angle between axes 1 and 2 (10°). Below it their common perpendicular is poorly determined.
pub const MIN_SINE: f64 = 0.174;

/// Base frame from the sweeps of joints 1 and 2.
///
/// z of frame 1 is along axis 1, x along the common perpendicular of axes 1 and 2, and the origin is where this perpendicular intersects
/// axis 1. In MDH z_2 = Rx(alpha_2)·z_1, so x_1 = sign(sin alpha_2) · (axis 1 × axis 2); this also holds if the axes intersect. The base
/// frame is frame 1 moved back by the nominal link 1, at the value of joint 1 during the sweep of joint 2.
///
/// # Errors
/// [`Error::ParallelAxes`], measured or nominal.
pub fn base_frame(
    robot: &Robot,
    sweep_1: &Sweep,
    sweep_2: &Sweep,
) -> Result<IsometryMatrix3<f64>, Error> {
    let sin_alpha_2 = libm::sin(robot.links[1].alpha_rad);
    let (axis_1, axis_2) = (sweep_1.circle.normal, sweep_2.circle.normal);
    let perpendicular = axis_1.cross(&axis_2);
    let sine = perpendicular.norm().min(sin_alpha_2.abs());
    if sine < MIN_SINE {
        return Err(Error::ParallelAxes {
            angle_deg: libm::asin(sine.min(1.0)).to_degrees(),
        });
    }
    let z = axis_1;
    let x = perpendicular.normalize() * sin_alpha_2.signum();
    let y = z.cross(&x);
    let origin = foot_on_first(
        &sweep_1.circle.centre_mm,
        &axis_1,
        &sweep_2.circle.centre_mm,
        &axis_2,
    );
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    let t_instrument_1 = IsometryMatrix3::from_parts(Translation3::from(origin), rotation);
    Ok(t_instrument_1 * t_previous_link(&robot.links[0], sweep_2.q_rad[0]).inverse())
}

/// Intersection of the common perpendicular of two lines (point, unit direction) with the first line.
fn foot_on_first(
    p1: &nalgebra::Vector3<f64>,
    u1: &nalgebra::Vector3<f64>,
    p2: &nalgebra::Vector3<f64>,
    u2: &nalgebra::Vector3<f64>,
) -> nalgebra::Vector3<f64> {
    let between = p2 - p1;
    let c = u1.dot(u2);
    p1 + u1 * ((between.dot(u1) - between.dot(u2) * c) / (1.0 - c * c))
}
