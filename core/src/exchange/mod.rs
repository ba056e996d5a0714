//! Robot descriptions of other systems: serial chains as in a URDF, Denavit-Hartenberg tables in the distal convention, joint origins by
//! roll, pitch and yaw, links for controllers without beta, mastering offsets. Only the geometry is here; the text formats are in
//! `operations`.

pub mod chain;
pub mod dh;
pub mod links;
pub mod origin;
pub mod refit;
pub mod transplant;
pub mod universal_robots;

pub use chain::{Chain, ChainJoint};
pub use links::{ImportedLinks, links_of_chain};
pub use origin::{Origin, origin_of, pose_of};
