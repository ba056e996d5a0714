//! Joint values with which the identified robot does what the nominal robot was told to.

pub mod anchor;
pub mod targets;

pub use anchor::{Anchor, anchor, anchor_in_measuring_frame};
pub use targets::{Base, Compensation, Corrected, Mode, Status, Tool};
