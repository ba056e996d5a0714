//! Answer about a job: status, stage and progress.

use crate::wire::job::{JobRequestBody, Kind, Method};
use crate::wire::problem::Problem;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobStatus {
    /// Waiting for a worker.
    Queued,
    /// A worker has it.
    Running,
    /// Done; report and parameter set exist.
    Succeeded,
    /// Over without a result; `error` says why.
    Failed,
    /// Stopped on request.
    Cancelled,
}

impl JobStatus {
    /// Its name in JSON and in the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether the status is final.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

impl TryFrom<String> for JobStatus {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        [
            Self::Queued,
            Self::Running,
            Self::Succeeded,
            Self::Failed,
            Self::Cancelled,
        ]
        .into_iter()
        .find(|status| status.as_str() == text)
        .ok_or_else(|| format!("unknown job status {text:?}"))
    }
}

/// What a running job is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The points are screened, and the method is chosen.
    Screening,
    /// The main method: least squares.
    LeastSquares,
    /// The main method: a swarm.
    Pso,
    /// The main method: a swarm that the robot's network begins.
    BpnnPso,
    /// A network is trained on the swarm.
    TrainNetwork,
    /// Least squares ends what the swarm began.
    Refine,
    /// What links cannot say is looked for.
    Corrections,
    /// Least squares on the same points, to compare with.
    CompareLeastSquares,
    /// A cold swarm on the same points, to compare with.
    ComparePso,
    /// A swarm from the last answer, to compare with.
    CompareWarmStart,
    /// Errors and uncertainties are worked out.
    Uncertainty,
    /// The uncertainty of what a partial recalibration held.
    HeldUncertainty,
    /// The session is compared with the one before.
    CompareSessions,
    /// A parameter set is scored.
    Verify,
}

impl Stage {
    /// All stages.
    pub const ALL: [Self; 14] = [
        Self::Screening,
        Self::LeastSquares,
        Self::Pso,
        Self::BpnnPso,
        Self::TrainNetwork,
        Self::Refine,
        Self::Corrections,
        Self::CompareLeastSquares,
        Self::ComparePso,
        Self::CompareWarmStart,
        Self::Uncertainty,
        Self::HeldUncertainty,
        Self::CompareSessions,
        Self::Verify,
    ];

    /// Name on the wire and in the core.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Screening => "screening",
            Self::LeastSquares => "least_squares",
            Self::Pso => "pso",
            Self::BpnnPso => "bpnn_pso",
            Self::TrainNetwork => "train_network",
            Self::Refine => "refine",
            Self::Corrections => "corrections",
            Self::CompareLeastSquares => "compare_least_squares",
            Self::ComparePso => "compare_pso",
            Self::CompareWarmStart => "compare_warm_start",
            Self::Uncertainty => "uncertainty",
            Self::HeldUncertainty => "held_uncertainty",
            Self::CompareSessions => "compare_sessions",
            Self::Verify => "verify",
        }
    }

    /// Stage with this name in the core.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.as_str() == name)
    }

    /// True for the main method. Iterations are counted for it only.
    pub fn has_iterations(self) -> bool {
        matches!(self, Self::LeastSquares | Self::Pso | Self::BpnnPso)
    }
}

/// How far a running job is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ProgressAnswer {
    /// What it is at; absent in what an older version wrote.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// Iterations of the main method that are done. Other stages follow it, and have none.
    pub iteration: u64,
    /// The limit, which is seldom reached; 0 before the main method.
    pub n_iterations: u64,
    /// Smallest F so far, mm².
    #[schema(required)]
    pub best_cost_mm2: Option<f64>,
}

/// A job as the service answers it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobAnswer {
    /// Opaque identifier.
    pub id: String,
    /// The robot.
    pub robot_id: String,
    /// The set it identifies from.
    pub measurement_set_id: String,
    /// What it does.
    pub kind: Kind,
    /// The method asked for; the report says which one ran.
    pub method: Method,
    /// What was asked, as it was understood.
    pub request: JobRequestBody,
    /// How it stands.
    pub status: JobStatus,
    /// How often a worker has begun it.
    pub attempt: u32,
    /// How far it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<ProgressAnswer>,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Problem>,
    /// The parameter set that it verifies, holds what is not identified at, or compares with, chosen when it was posted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_from: Option<String>,
    /// Its parameter set, once it has succeeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_id: Option<String>,
    /// The network it trained, if it was a swarm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network_id: Option<String>,
    /// The residual network that its training began at, chosen when it was posted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_network_from: Option<String>,
    /// The residual network it kept, if one won.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_network_id: Option<String>,
    /// RFC 3339, UTC.
    pub created_at: String,
    /// RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started_at: Option<String>,
    /// RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finished_at: Option<String>,
}

/// One server-sent event of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobEvent {
    /// `progress` whenever the job moves, `finished` once when it is over.
    pub event: JobEventName,
    /// The job, in JSON.
    pub data: String,
}

/// What a job's event is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobEventName {
    /// The job moved.
    Progress,
    /// The job is over; nothing follows.
    Finished,
}
