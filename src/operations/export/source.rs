//! Inputs of an export.

use crate::compensation::Base;
use crate::identification::least_squares::problem::BASE_RAD;
use crate::kinematics::Robot;
use crate::release::orientation_unknown;
use crate::wire::measurement::Frame;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::RobotBody;
use nalgebra::IsometryMatrix3;

/// Inputs of an export.
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Id of the parameter set.
    pub id: &'a str,
    /// The nominal robot as it was uploaded.
    pub body: &'a RobotBody,
    /// The nominal robot as a type of the core.
    pub robot: &'a Robot,
    /// Content of the parameter set.
    pub content: &'a ParameterSetContent,
    /// Provenance of the set, and its warnings.
    pub provenance: &'a Provenance,
}

/// Distance (mm) and angle (rad) below which the base counts as equal to the frame of the measured positions.
const SAME_BASE_MM: f64 = 1e-3;
const SAME_BASE_RAD: f64 = 1e-6;
/// Largest rotation of the base that counts as none, in standard deviations of its prior.
const MAX_BASE_STDS: f64 = 3.0;

impl Source<'_> {
    /// The frame in which mastering offsets are fitted: that of the measured positions if it is the base frame and the base is really
    /// there. The offset of joint 1 is then visible. A base that is rotated by more than its uncertainty shows nothing about joint 1.
    pub fn mastering_base(&self) -> Base {
        let turned_rad = IsometryMatrix3::from(&self.content.t_instrument_base)
            .rotation
            .angle();
        let is_there = turned_rad <= MAX_BASE_STDS * BASE_RAD;
        match self.provenance.measuring_frame {
            Some(Frame::Base) if is_there => Base::Measured,
            _ => Base::Robot,
        }
    }

    /// Remarks for formats that contain only joint origins and have comments: what they leave out of the base, and whether the positions show how the
    /// flange is turned.
    pub fn remarks(&self) -> Vec<String> {
        let turned = orientation_unknown(self.provenance, self.robot.links.len());
        let turned = turned
            .map(|why| format!("Only the measured reflector is where these origins say: {why}."));
        self.base_left_out().into_iter().chain(turned).collect()
    }

    /// Such a format leaves out the pose of the base in the frame of the measured positions. None if both frames are equal, or if positions were
    /// measured in the frame of an instrument.
    fn base_left_out(&self) -> Option<String> {
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
                turned_rad.to_degrees()
            )
        })
    }
}
