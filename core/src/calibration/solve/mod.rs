//! Methods and their answers: least squares, swarms, corrections, the final fit.

pub mod choice;
pub mod corrections;
pub mod final_fit;
pub mod larger_model;
pub mod most_probable;
pub mod solution;
pub mod swarms;
