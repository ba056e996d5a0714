//! Answer about a job: status, stage and progress.

use crate::wire::job::{JobRequestBody, Kind, Method};
use crate::wire::names;
use crate::wire::problem::Problem;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

names! {
    /// Status of a job.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
    #[serde(rename_all = "snake_case")]
    pub enum JobStatus {
        /// Waiting for a worker.
        Queued = "queued",
        /// A worker computes the job.
        Running = "running",
        /// Done; the report exists, and after an identification the parameter set.
        Succeeded = "succeeded",
        /// Ended without a result; `error` has the cause.
        Failed = "failed",
        /// Cancelled on request.
        Cancelled = "cancelled",
    }
}

impl JobStatus {
    /// Whether the status is final.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

names! {
    /// Stage of a running job.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
    #[serde(rename_all = "snake_case")]
    pub enum Stage {
        /// The points are screened, and the method is chosen.
        Screening = "screening",
        /// The main method: least squares.
        LeastSquares = "least_squares",
        /// The main method: a swarm.
        Pso = "pso",
        /// The main method: a swarm that starts from the robot's network.
        BpnnPso = "bpnn_pso",
        /// A network is trained on the swarm.
        TrainNetwork = "train_network",
        /// Least squares refines the swarm's result.
        Refine = "refine",
        /// The job searches for corrections in addition to link parameters.
        Corrections = "corrections",
        /// Least squares on the same points, for comparison.
        CompareLeastSquares = "compare_least_squares",
        /// A cold swarm on the same points, for comparison.
        ComparePso = "compare_pso",
        /// A swarm that starts from the last identified parameters, for comparison.
        CompareWarmStart = "compare_warm_start",
        /// The delivered parameters are fitted to all points of the upload.
        FinalFit = "final_fit",
        /// Errors and uncertainties are computed.
        Uncertainty = "uncertainty",
        /// The uncertainty of the parameters that a partial recalibration holds is computed.
        HeldUncertainty = "held_uncertainty",
        /// The session is compared with the previous session, or the sessions of the job are compared with each other.
        CompareSessions = "compare_sessions",
        /// A parameter set is scored.
        Verify = "verify",
    }
}

impl Stage {
    /// The stage that has this name in the core.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.as_str() == name)
    }

    /// True for the main method. Iterations are counted only in these stages.
    pub fn has_iterations(self) -> bool {
        matches!(self, Self::LeastSquares | Self::Pso | Self::BpnnPso)
    }
}

/// Progress of a running job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ProgressAnswer {
    /// Current stage; absent in progress that an older version stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// Number of finished iterations of the main method. The stages after the main method have no iterations.
    pub iteration: u64,
    /// Maximum number of iterations, which is rarely reached; 0 before the main method.
    pub n_iterations: u64,
    /// Smallest F so far, mm².
    #[schema(required)]
    pub best_cost_mm2: Option<f64>,
}

/// What a succeeded job found against the parameter set that it scored or identified, or against its points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The points do not fit the robot.
    DoesNotFit,
    /// The set is far off at these points.
    SetFarOff,
    /// The set is no better than the nominal robot.
    NoBetterThanNominal,
    /// The set is several times worse than when it was identified, or than a robot that is fitted to these points.
    WorseThanIdentified,
}

/// A job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobAnswer {
    /// Opaque identifier.
    pub id: String,
    /// The robot.
    pub robot_id: String,
    /// The measurement set. With several sessions, the set of the first session; `request` has all sets.
    pub measurement_set_id: String,
    /// Name of that measurement set, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_set_name: Option<String>,
    /// Its kind.
    pub kind: Kind,
    /// The requested method. The report has the method that was used.
    pub method: Method,
    /// The request, as it was parsed.
    pub request: JobRequestBody,
    /// Its status.
    pub status: JobStatus,
    /// Number of attempts.
    pub attempt: u32,
    /// Progress of the current attempt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<ProgressAnswer>,
    /// Why the job failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Problem>,
    /// The parameter set that the job verifies, whose values it holds, or whose session it is compared with. It is chosen when the job is posted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_from: Option<String>,
    /// The parameter set that the job identified, once it has succeeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_id: Option<String>,
    /// The network that the job trained, if its method was a swarm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network_id: Option<String>,
    /// The residual network from which training continues. It is chosen when the job is posted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_network_from: Option<String>,
    /// The residual network that the job trained, if its corrections use one.
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
    /// Version of the robot that the job computes with, if the robot had been edited.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_version: Option<i64>,
    /// When it was archived: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
    /// Once it has succeeded: rms error of the nominal robot on the points that were not fitted, mm. Without such points, on the fitted points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal_rms_mm: Option<f64>,
    /// Once it has succeeded: rms error of the parameter set on the same points, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_mm: Option<f64>,
    /// What it found against the parameter set or its points; absent if it found nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finding: Option<Finding>,
}

/// One server-sent event of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobEvent {
    /// `progress` after each change of the job, `finished` once when the job has ended.
    pub event: JobEventName,
    /// The job, in JSON.
    pub data: String,
}

names! {
    /// Name of a job's event.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
    #[serde(rename_all = "snake_case")]
    pub enum JobEventName {
        /// The job has changed.
        Progress = "progress",
        /// The job has ended; no event follows.
        Finished = "finished",
    }
}
