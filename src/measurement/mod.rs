//! Measurement sets: parsing of files, units, joining of two files, and the split into identify and verify subsets.

pub mod column_mapping;
pub mod column_meaning;
pub mod column_names;
mod conventions;
pub mod csv;
mod csv_columns;
mod csv_issue;
pub mod csv_pose;
mod csv_text;
pub mod join;
mod join_options;
mod join_time;
pub mod number_text;
mod pose_names;
pub mod position_noise;
pub mod programs;
pub mod repeatability;
pub mod rotation_convention;
pub mod sessions;
pub mod set;
pub mod split;
pub mod table;
mod table_cells;
pub mod table_columns;
mod table_halves;
mod table_header;
mod table_lines;
mod table_numbers;
pub mod table_points;
pub mod table_targets;
pub mod table_text;

pub use conventions::{Decimal, Frame, Subset};
pub use rotation_convention::RotationConvention;
pub use set::{MeasurementSet, Point};
