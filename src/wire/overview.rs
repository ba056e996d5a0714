//! Every robot with what it needs: the list for somebody who looks after hundreds of them.

use crate::wire::job::Kind;
use crate::wire::job_answer::JobStatus;
use crate::wire::parameter_set::ParameterSetStatus;
use crate::wire::report_shape::Evidence;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a robot needs. The order is that of urgency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Need {
    /// A session did not fit the robot.
    CheckRobot,
    /// The newest session of the released set exceeds the tolerance, or is much worse than the set was when it was identified.
    Drifted,
    /// The newest job failed.
    JobFailed,
    /// A newer result than the released set, or the first one, waits for a decision.
    Review,
    /// The error reaches its limit within the next days, or has reached it.
    Due,
    /// Nothing was identified yet.
    Calibrate,
    /// Nothing.
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
    /// Error of the nominal robot on the points that the set was judged on, mm; null if it is not known.
    #[schema(required)]
    pub before_rms_mm: Option<f64>,
    /// Error of the set on them, mm; null if it is not known.
    #[schema(required)]
    pub after_rms_mm: Option<f64>,
    /// Strength of that verification; null if it is not known.
    #[schema(required)]
    pub evidence: Option<Evidence>,
}

/// The last job of a robot in the overview.
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
    /// RFC 3339, UTC; absent until it has ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finished_at: Option<String>,
}

/// The newest session that the released set was scored on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SessionOverview {
    /// The job that scored it.
    pub job_id: String,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// Error of the released set, mm; null if it is not known.
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
    /// What it needs most.
    pub need: Need,
    /// Why, in one sentence; empty where it needs nothing.
    pub reason: String,
    /// The job that shows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub need_job_id: Option<String>,
    /// The released set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<SetOverview>,
    /// The newest set that was not withdrawn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub newest: Option<SetOverview>,
    /// The newest session of the released set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionOverview>,
    /// Days until the error reaches its limit; absent if that cannot be said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub days_to_limit: Option<f64>,
    /// The newest job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_job: Option<JobOverview>,
}
