//! Joins the robot's file and the instrument's file.

mod clock;
mod labels;
mod options;
mod pairing;
mod time;

pub use options::{JoinBy, JoinError, JoinOptions};
pub use pairing::{Join, Leftover, join};
