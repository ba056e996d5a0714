//! Operations that compute a result from their inputs and store nothing: predictions, compensation, pose plans, frames, comparisons of parameter
//! sets, imports and exports. The server and the command line call the same functions.

mod compare;
mod compensate;
pub mod export;
mod frames;
pub mod import;
mod import_digits;
mod import_json;
mod import_table;
mod import_units;
mod plan_poses;
mod posture;
mod predict;
pub mod program;
mod references;
pub mod robot_models;
pub mod rotation_convention;
mod table_preview;
pub mod urdf;
mod urdf_joint;
mod work_frame;
pub mod xml_limits;

pub use compare::{IdentifiedSet, compare};
pub use compensate::{Correctable, compensate};
pub use frames::frames_from_sweeps;
pub use plan_poses::plan_poses;
pub use posture::{MAX_APART, posture};
pub use predict::predict;
pub use references::check_reference;
pub use table_preview::preview_table;
pub use work_frame::{check_new_work_frame, check_station, fitting_work_frame, work_frame_answer};
