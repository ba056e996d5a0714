//! The fast cost kernel: F of eight particles at once over all poses, without trigonometry in the inner loop.
//!
//! `forward.rs` is its oracle. Commanded rotations and the particles' parameters are kept apart. With
//!
//! ```text
//! M_0 = base · Rx(alpha_1) · Dx(a_1) · Ry(beta_1)
//! M_i = Rz(theta_offset_i) · Dz(d_i) · Rx(alpha_{i+1}) · Dx(a_{i+1}) · Ry(beta_{i+1})     0 < i < n
//! M_n = Rz(theta_offset_n) · Dz(d_n) · target
//! ```
//!
//! the chain of [Gao 2018, eq. 2, 3] is `M_0 · Rz(q_1) · M_1 · Rz(q_2) · … · Rz(q_n) · M_n`. The M depend only on the particle and are computed once
//! per particle ([`LaneRobots::set`]). The rotations by q depend only on the pose and are computed once per job ([`PreparedPoses`]).
//!
//! Lanes contain particles, so each particle's sum runs in pose order for every vector width. Products are added with an explicit fused multiply-add.
//! The results are therefore the same on every CPU, to the last bit ([`InstructionSet`]).

mod affine;
mod along;
mod bound;
mod elimination;
mod kernel;
mod lane_link;
mod lanes;
mod lower_bound;
mod one_robot;
mod pose_lanes;
mod poses;
mod robots;
mod sincos;

pub use along::Along;
pub use bound::Bound;
pub use elimination::Elimination;
pub use kernel::sum_of_squares;
pub use lanes::{InstructionSet, LANES, Lanes};
pub use lower_bound::{Anchored, LowerBound};
pub use one_robot::OneRobot;
pub use pose_lanes::PoseLanes;
pub use poses::PreparedPoses;
pub use robots::{LaneRobots, Moved};
