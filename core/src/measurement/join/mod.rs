//! Joins the robot's file and the instrument's file.

mod by_names;
mod clock;
mod labels;
mod logs;
mod name_parts;
mod options;
mod pairing;
mod standstills;
mod time;
mod times;

pub use name_parts::LeftOut;
pub use options::{JoinBy, JoinError, JoinOptions};
pub use pairing::{Join, Leftover, join};
