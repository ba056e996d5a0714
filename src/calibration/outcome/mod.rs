//! From an answer to the report.

pub mod assemble;
pub mod delivery;
pub mod parameters;
pub mod stated_uncertainty;
