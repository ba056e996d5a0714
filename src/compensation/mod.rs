//! Joint values with which the identified robot does what the nominal robot was told to.

pub mod anchor;
pub mod targets;

pub use anchor::{Anchor, anchor};
pub use targets::{Compensation, Corrected, Mode, Status, Tool};
