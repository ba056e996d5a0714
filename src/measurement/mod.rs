//! Measured poses: the set, its CSV form, units and the split into identify and verify.

mod conventions;
pub mod csv;
mod csv_columns;
mod csv_issue;
pub mod csv_pose;
mod csv_text;
pub mod repeatability;
pub mod rotation_convention;
pub mod set;
pub mod split;

pub use conventions::{Decimal, Frame, Subset};
pub use rotation_convention::RotationConvention;
pub use set::{MeasurementSet, Point};
