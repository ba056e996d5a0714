//! Warnings of a report.

pub mod last_joint;
pub mod orientation;
pub mod plausibility;
pub mod screening;
pub mod unobservable;
