//! Trend of a robot's error over time.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The error of the released parameter set over the sessions that it was scored on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trend {
    /// Sessions in it: the identification's held-out points, and jobs of kind `verify`.
    pub n_sessions: usize,
    /// Growth of the rms error; null without enough data.
    #[schema(required)]
    pub rms_mm_per_day: Option<f64>,
    /// Interval that contains it with 95 % probability.
    #[schema(required)]
    pub interval_95: Option<[f64; 2]>,
    /// The error that counts as too large, mm.
    #[schema(required)]
    pub limit_mm: Option<f64>,
    /// Days from the last session until the line reaches the limit; null if the error does not grow beyond chance, or not within ten years.
    #[schema(required)]
    pub days_to_limit: Option<f64>,
    /// Description.
    pub detail: String,
}
