//! Joint values with which the identified robot does what the nominal robot was told to.

pub mod anchor;
mod difference;
mod mode;
pub mod targets;

pub use anchor::{Anchor, anchor, anchor_in_measuring_frame};
pub use difference::{ToolDifference, ToolDifferences, tool_differences};
pub use mode::{Base, Mode, Status};
pub use targets::{Compensation, Corrected, Tool};
