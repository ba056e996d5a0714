//! What is exported.

use crate::kinematics::Robot;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::RobotBody;

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
