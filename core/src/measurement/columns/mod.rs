//! Columns of files: their names, meanings and units, and what a caller states about them.

pub(super) mod column;
pub mod mapping;
pub mod meaning;
pub mod names;
pub mod pose;
pub(super) mod pose_names;
mod units;
pub(super) mod words;
