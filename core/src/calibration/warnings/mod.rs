//! Warnings of a report.

pub mod last_joint;
pub mod orientation;
mod over_session;
pub mod overstated_noise;
pub mod plausibility;
pub mod refused_upload;
pub mod screening;
pub mod unobservable;
