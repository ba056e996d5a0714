//! The least-squares problem, its noise and prior widths, its start, and its most probable values.

mod block;
pub mod estimate;
pub mod evidence;
pub mod hand_eye;
pub mod linearisation;
pub mod multistart;
mod parts;
pub mod problem;
pub mod start;
pub mod variables;
