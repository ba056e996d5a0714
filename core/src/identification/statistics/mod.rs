//! Uncertainty of the identified robot, and tests whether two sessions show the same robot.

pub mod changes;
mod difference;
pub mod distributions;
pub mod estimate;
pub mod hidden_zeros;
pub mod misfit;
pub mod quick_check;
pub mod uncertainty;
mod uncertainty_problem;
mod uncertainty_solution;
pub mod variance;
pub mod workspace;
