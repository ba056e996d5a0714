//! History of a robot's parameters, and the comparison of two parameter sets.

use crate::calibration::report::Changes;
use crate::compensation::ToolDifference;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::{ChangeReport, ParameterReport};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A page of a robot's history.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HistoryAnswer {
    /// Newest first.
    pub items: Vec<HistoryItem>,
    /// Cursor for the next page, if there is one.
    #[schema(required)]
    pub next_cursor: Option<String>,
    /// Number of identifications on all pages.
    #[serde(default)]
    #[schema(minimum = 0, required)]
    pub total: i64,
    /// Growth of the error of the released parameter set, and when to calibrate next.
    pub trend: Trend,
}

/// One identification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HistoryItem {
    /// The parameter set.
    pub parameter_set_id: String,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// Its status.
    pub status: ParameterSetStatus,
    /// Every free parameter, with its uncertainty.
    pub parameters: Vec<ParameterReport>,
    /// Root mean square error of the held-out points, mm; null if there were no held-out points.
    #[schema(required)]
    pub verify_rms_mm: Option<f64>,
    /// Significant changes since the previous session, in units of their standard uncertainty. Empty if no change is significant, or if there was no
    /// previous session.
    pub changed: Vec<ChangeReport>,
    /// When the job that identified it was archived: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job_archived_at: Option<String>,
}

/// Differences between two parameter sets of one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CompareAnswer {
    /// The set in the path.
    pub parameter_set_id: String,
    /// The set it is compared with.
    pub with: String,
    /// Mean distance between the tool positions of the two sets over the map, mm.
    pub mean_mm: f64,
    /// Largest distance over the map, mm.
    pub max_mm: f64,
    /// Tool positions at seeded random configurations within the joint limits.
    pub map: Vec<MapPoint>,
    /// Test whether the sessions of the two sets differ significantly. Null if both sets come from one upload, or if one of the sessions is too small
    /// to identify parameters from it alone.
    #[schema(required)]
    pub sessions: Option<SessionTest>,
}

/// One configuration of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MapPoint {
    /// The controller's joint values, degrees.
    pub q_deg: Vec<f64>,
    /// Position of the tool of the nominal robot, in the base frame, mm.
    pub position_mm: [f64; 3],
    /// Tool position with the set in the path − tool position with the other set, in the base frame, mm.
    pub difference_mm: [f64; 3],
}

/// A joint test of all link parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionTest {
    /// Test statistic dᵀ·V⁻¹·d, where d is the difference of the combinations of link parameters that both sessions determine.
    pub chi_square: f64,
    /// Number of these combinations.
    pub n_combinations: usize,
    /// p-value: probability of at least this value for an unchanged robot.
    pub probability: f64,
    /// All differences, including those of base and targets.
    pub changed: Vec<ChangeReport>,
}

impl From<&Changes> for SessionTest {
    fn from(changes: &Changes) -> Self {
        Self {
            chi_square: changes.chi_square,
            n_combinations: changes.n_combinations,
            probability: changes.probability,
            changed: changes.all.clone(),
        }
    }
}

impl From<&ToolDifference> for MapPoint {
    fn from(point: &ToolDifference) -> Self {
        let q_deg = point.q_controller_rad.iter().map(|rad| rad.to_degrees());
        Self {
            q_deg: q_deg.collect(),
            position_mm: point.position_mm.into(),
            difference_mm: point.difference_mm.into(),
        }
    }
}

/// The error of the released parameter set over the sessions that it was scored on. The time of a session is its time of measurement if
/// its upload states one, else the time of its upload.
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
