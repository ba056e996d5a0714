//! Finds outliers, motions and drifts during the measurement.

pub mod backlash;
pub mod columns;
pub mod drift;
pub mod outliers;
pub mod row_order;
pub mod settling;
pub mod steps;
pub mod target_turns;
pub mod whitening;
