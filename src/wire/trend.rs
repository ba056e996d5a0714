//! Trend of a robot's error over time.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The error of the released parameter set over the sessions that it was scored on. A session stands at the time at which it was measured, as its upload
/// states, else at that of its upload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Trend {
    /// Number of sessions: the held-out points of the identification, and the uploads that the set was scored on.
    pub n_sessions: usize,
    /// Growth of the rms error, mm per day; null if there are not enough data.
    #[schema(required)]
    pub rms_mm_per_day: Option<f64>,
    /// Interval that contains the growth with 95 % probability, mm per day.
    #[schema(required)]
    pub interval_95: Option<[f64; 2]>,
    /// Limit of the error, mm.
    #[schema(required)]
    pub limit_mm: Option<f64>,
    /// Days from the last session until the trend line reaches the limit. Null if the growth is not significant, or if the limit is not reached
    /// within ten years.
    #[schema(required)]
    pub days_to_limit: Option<f64>,
    /// Description of the trend.
    pub detail: String,
}
