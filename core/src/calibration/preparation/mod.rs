//! From a request to the problem that is solved: checks, screening, segments and set-ups, priors.

pub mod all_fit;
pub mod arrangement;
pub mod check;
pub mod equations;
mod gross_errors;
pub mod loss;
pub mod motions;
pub mod observe;
pub mod placed_weights;
pub mod prepare;
pub mod row_weights;
pub mod screening;
pub mod stated_priors;
mod turned_poses;
