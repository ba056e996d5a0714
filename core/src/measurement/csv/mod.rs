//! Cells: the limits of their values, the points that they become, and the numbers in them.

pub mod number_text;
mod row;

pub use crate::measurement::issue::{Issue, MAX_ISSUES, ParseError};
pub use crate::measurement::position_noise::{MAX_STD_MM, MIN_STD_MM};
pub use row::{
    EXAMPLE_OF_A_TIME, MAX_COORDINATE_MM, MAX_JOINT_RAD, MAX_LABEL_LENGTH, MAX_ROWS, MAX_TARGETS,
    MAX_TEMPERATURE_C,
};
pub(super) use row::{PULSES, Reading, parse_row, wrong_cell_count};
