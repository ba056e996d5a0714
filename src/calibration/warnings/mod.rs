//! Warnings of a report.

pub mod orientation;
pub mod plausibility;
pub mod screening;
pub mod unobservable;
