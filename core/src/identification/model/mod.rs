//! The model that is identified: its parameters with scales and priors, and what it predicts at measured points.

mod choices;
pub mod corrected_pose;
pub mod correction_terms;
pub mod identifiability;
pub mod objective;
pub mod parameters;
pub mod pose_rows;
pub mod priors;
pub mod search_space;

pub use choices::{Model, Preset};
