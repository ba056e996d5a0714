//! Compensation: joint values with which the identified robot does what the nominal robot was commanded to do.

pub mod anchor;
mod cartesian;
mod difference;
mod fixture_doubt;
mod fixture_misfit;
mod mode;
pub mod targets;
mod tool_error;
mod work_frame;

pub use anchor::{Anchor, HeldReflector, anchor};
pub use cartesian::CorrectedPose;
pub use difference::{ToolDifference, ToolDifferences, tool_differences};
pub use fixture_doubt::FixtureDoubt;
pub use fixture_misfit::{FixtureMisfit, FixtureMistake};
pub use mode::{Base, Mode, Status};
pub use targets::{Compensation, Corrected, Tool};
pub use tool_error::{ToolError, ToolGoal, ToolPoint};
pub use work_frame::{FixturePoint, WorkFrame, WorkFrameError};
