//! What a request makes of its inputs without storing anything: predictions, corrected targets, pose plans, frames, comparisons of parameter sets,
//! imports and exports. Server and command line call the same functions.

mod compare;
mod compensate;
pub mod export;
mod frames;
pub mod import;
mod plan_poses;
mod predict;
pub mod rotation_convention;
pub mod urdf;
pub mod xml_limits;

pub use compare::{IdentifiedSet, compare};
pub use compensate::compensate;
pub use frames::frames_from_sweeps;
pub use plan_poses::plan_poses;
pub use predict::predict;
