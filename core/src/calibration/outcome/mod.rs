//! Builds the report from the identified model.

pub mod assemble;
pub mod delivery;
pub mod parameters;
pub mod stated_uncertainty;
