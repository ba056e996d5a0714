//! Validation on points that were not fitted: errors, verification, sessions, repeated rows.

pub mod check_in_words;
pub mod coverage;
pub mod enough_points;
pub mod errors;
pub mod fit;
pub mod quick_check;
pub mod repeatability;
pub mod repeated_rows;
pub mod robust_comparison;
pub mod same_poses;
pub mod session_fit;
pub mod verdict;
pub mod verification_set;
pub mod verify;
