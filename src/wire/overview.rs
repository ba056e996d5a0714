//! Overview of all robots, with what each robot needs next. It is made for a person who looks after hundreds of robots.

use crate::wire::job::Kind;
use crate::wire::job_answer::JobStatus;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a robot needs next. The variants are sorted by urgency, the most urgent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Need {
    /// A session did not fit the robot.
    CheckRobot,
    /// The error of the released set in the newest session exceeds the tolerance, or is much larger than when the set was identified.
    Drifted,
    /// The released set was withdrawn, and no other is released: the cell has no parameters.
    Withdrawn,
    /// The newest job failed.
    JobFailed,
    /// A new parameter set (newer than the released set, or the first one) waits for a decision.
    Review,
    /// The error will reach its limit within the next days, or has already reached it.
    Due,
    /// No parameters were identified yet.
    Calibrate,
    /// The robot needs nothing.
    Nothing,
}

/// A parameter set of a robot in the overview.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SetOverview {
    /// The parameter set.
    pub id: String,
    /// The job that identified it.
    pub job_id: String,
    /// Its status.
    pub status: ParameterSetStatus,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// RFC 3339, UTC; absent if it was never released.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released_at: Option<String>,
    /// rms error of the nominal robot on the points that verified the set, mm; null if it is not known.
    #[schema(required)]
    pub before_rms_mm: Option<f64>,
    /// rms error of the set on the same points, mm; null if it is not known.
    #[schema(required)]
    pub after_rms_mm: Option<f64>,
    /// Strength of this verification; null if it is not known.
    #[schema(required)]
    pub evidence: Option<Evidence>,
    /// Of a candidate: the first gate that refuses its release now, of the gates that stored facts decide: `joint_map_changed`,
    /// `upload_not_insisted`, `fits`, `check_robot`, `verified`, `verify_errors_improved`, `uncertainty_within_tolerance`,
    /// `verify_errors_within_tolerance`, `sessions_fit`, `sessions_better_than_nominal`, `measured_since_check`, `evidence`. Absent if none of them
    /// does. The other gates read points and documents; `GET /v1/parameter-sets/{id}/gates` decides all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused_by: Option<String>,
    /// Of the newest set: number of points of the uploads that it was identified from. With more of them, its gates take longer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_points: Option<i64>,
}

/// The newest job of a robot in the overview.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobOverview {
    /// The job.
    pub id: String,
    /// Its kind.
    pub kind: Kind,
    /// Its status.
    pub status: JobStatus,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// RFC 3339, UTC; absent until the job has ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finished_at: Option<String>,
}

/// The newest session that the released set was scored on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionOverview {
    /// The job that scored the set.
    pub job_id: String,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// When the session was measured, if its upload states it: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_at: Option<String>,
    /// rms error of the released set, mm; null if it is not known.
    #[schema(required)]
    pub rms_mm: Option<f64>,
}

/// One robot in the overview.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotOverview {
    /// The robot.
    pub robot_id: String,
    /// Its name.
    pub name: String,
    /// Its serial number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// The most urgent need of the robot.
    pub need: Need,
    /// Reason for the need, in one sentence; empty if the robot needs nothing.
    pub reason: String,
    /// The job that shows the need.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub need_job_id: Option<String>,
    /// The released set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<SetOverview>,
    /// The newest set that was not withdrawn, and neither archived nor of an archived job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub newest: Option<SetOverview>,
    /// The newest session of the released set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionOverview>,
    /// Days until the error reaches its limit; absent if this cannot be predicted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub days_to_limit: Option<f64>,
    /// The newest job that is not archived.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_job: Option<JobOverview>,
}
