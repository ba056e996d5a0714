//! What is exported.

use crate::kinematics::Robot;
use crate::wire::angle::to_degrees;
use crate::wire::measurement::Frame;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::RobotBody;
use nalgebra::IsometryMatrix3;

/// What is exported.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// The parameter set's id.
    pub id: &'a str,
    /// The nominal robot as it was given.
    pub body: &'a RobotBody,
    /// The same for the core.
    pub robot: &'a Robot,
    /// What was identified.
    pub content: &'a ParameterSetContent,
    /// Where it comes from, and what one should know before using it.
    pub provenance: &'a Provenance,
}

/// A base that is nearer to the frame of the measured positions than this lies in it, mm and rad.
const SAME_BASE_MM: f64 = 1e-3;
const SAME_BASE_RAD: f64 = 1e-6;

impl Source<'_> {
    /// What joint origins leave out: where the base lies in the base frame that positions were measured in.
    pub fn base_left_out(&self) -> Option<String> {
        if self.provenance.measuring_frame != Some(Frame::Base) {
            return None;
        }
        let t_measured_base = IsometryMatrix3::from(&self.content.t_instrument_base);
        let [x, y, z] = t_measured_base.translation.vector.into();
        let turned_rad = t_measured_base.rotation.angle();
        let is_same =
            t_measured_base.translation.vector.norm() < SAME_BASE_MM && turned_rad < SAME_BASE_RAD;
        (!is_same).then(|| {
            format!(
                "The measured positions place the robot's base at {x:.3}, {y:.3}, {z:.3} mm of the base frame that they are stated in, turned by \
                 {:.4} degrees. These origins leave that out: place the robot there in the cell, or correct targets with kincal.",
                to_degrees(turned_rad)
            )
        })
    }
}
