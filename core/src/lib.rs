//! The numeric core of kincal: pure functions over plain data. No IO, no async, no clock, no unseeded randomness.
//!
//! `ARCHITECTURE.md` has the map and the reasons; `tests/architecture/main.rs` checks which module may use which.

pub mod calibration;
pub mod compensation;
pub mod exchange;
pub mod frames;
pub mod identification;
pub mod kinematics;
pub mod measurement;
pub mod planning;
pub mod solvers;
