//! The robot's geometry: modified Denavit-Hartenberg (Craig) links, forward kinematics and its derivatives. Also the corrections of effects that
//! links cannot describe: compliance under gravity, harmonics of the joints, a residual network.

pub mod batch;
pub mod compliance;
pub mod corrections;
pub mod forward;
pub mod jacobian;
pub mod model;
pub mod region;
pub mod rotation;

pub use corrections::{Compliance, Corrections, Harmonic, Payload, ResidualNetwork};
pub use forward::{forward_kinematics, t_base_flange};
pub use jacobian::{PositionJacobian, placement_jacobian, position_jacobian};
pub use model::{JointMap, Link, Mounting, Robot, reach_mm};
pub use region::MeasuredRegion;
