//! Identification of corrections for what link parameters cannot describe ([`crate::kinematics::compliance`]): their fit together with the links,
//! and the selection of those that are kept.

pub mod corrected;
mod fit;
mod folds;
mod network;
mod selection;

pub use fit::{Fitted, Setting};
pub use folds::Evidence;
pub use selection::{COMPLIANCE, Selected, refit, select};
