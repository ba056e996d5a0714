//! Measured poses: the set, its CSV form, units and the split into identify and verify.

pub mod csv;
mod csv_text;
pub mod repeatability;
pub mod set;
pub mod split;

pub use set::{Frame, MeasurementSet, Point, Subset};
