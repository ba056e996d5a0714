//! Measurement sets: parsing of files, units, joining of two files, and the split into identify and verify subsets.

pub mod columns;
mod conventions;
pub mod csv;
pub mod issue;
pub mod join;
pub mod position_noise;
pub mod programs;
pub mod repeatability;
pub mod rotation_convention;
pub mod sessions;
pub mod set;
pub mod split;
pub mod table;

pub use conventions::{Decimal, Frame, Subset};
pub use rotation_convention::RotationConvention;
pub use set::{MeasurementSet, Point};
