//! Where an identified robot has its target.

use nalgebra::{IsometryMatrix3, Vector3};

use crate::kinematics::{Link, forward_kinematics};

/// Position of a target in the measuring frame, mm: t_instrument_base · Π links · target. `q_rad` are the model's joint values
/// ([`crate::kinematics::Robot::q_model_rad`] makes them from the controller's).
pub fn predict(links: &[Link], t_instrument_base: &IsometryMatrix3<f64>, p_flange_target_mm: &Vector3<f64>, q_rad: &[f64]) -> Vector3<f64> {
    let p = forward_kinematics(links, q_rad, p_flange_target_mm);
    t_instrument_base.rotation * p + t_instrument_base.translation.vector
}
