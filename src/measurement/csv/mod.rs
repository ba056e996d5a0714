//! Measurement sets as CSV, and the numbers in cells.

pub mod number_text;
mod parse;
pub(super) mod text;

pub use crate::measurement::issue::{Issue, MAX_ISSUES, ParseError};
pub use crate::measurement::position_noise::{MAX_STD_MM, MIN_STD_MM};
pub use parse::{
    Conventions, EXAMPLE_OF_A_TIME, MAX_COORDINATE_MM, MAX_JOINT_RAD, MAX_LABEL_LENGTH, MAX_ROWS,
    MAX_TARGETS, MAX_TEMPERATURE_C, parse, parse_as, parse_with,
};
pub(super) use parse::{PULSES, Reading, parse_row, wrong_cell_count};
