//! The robot's geometry: modified Denavit-Hartenberg (Craig) links, forward kinematics and its derivatives.

pub mod batch;
pub mod forward;
pub mod jacobian;
pub mod model;

pub use forward::{forward_kinematics, t_base_flange};
pub use jacobian::{PositionJacobian, position_jacobian};
pub use model::{JointMap, Link, Mounting, Robot};
