//! JSON types of a report. Parts that do not differ from the core's are the core's own types, under the names of their schemas.

pub use crate::calibration::CheckVerdict;
pub use crate::calibration::quick_check::{
    DetectableChange as DetectableReport, QuickCheck as CheckReport,
};
pub use crate::calibration::report::{
    ErrorModel as ErrorModelReport, Errors as ErrorsReport, FinalErrors as FinalFitReport,
    Identifiability as IdentifiabilityReport, NamedChange as ChangeReport,
    ParameterOutcome as ParameterReport, PriorOutcome as PriorReport,
    Repeatability as RepeatabilityReport, SubsetErrors as SubsetReport,
};
pub use crate::identification::corrections::Evidence as CorrectionReport;
use crate::wire::job::{Method, Model, Preset};
use crate::wire::measurement::{Subset, Warning};
use crate::wire::names;
use crate::wire::reference::ReferenceReport;
use crate::wire::sessions::PooledReport;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The report of one job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// The job.
    pub job_id: String,
    /// An earlier parameter set: the set that was verified, whose values were held, or that `changed` compares with. Absent if there was none, or if
    /// the nominal robot was verified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_from: Option<String>,
    /// When the session was measured, if its upload states it: RFC 3339, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_at: Option<String>,
    /// The method that was used.
    pub method: Method,
    /// Reason why this method was used.
    pub method_reason: String,
    /// The model that was identified.
    pub model: Model,
    /// The preset.
    pub preset: Preset,
    /// The seed.
    pub seed: u64,
    /// The version of kincal that computed the report.
    pub version: String,
    /// Why the main method stopped.
    pub termination: String,
    /// Number of swarm updates or least-squares steps, without those of refinement and comparison.
    pub n_iterations: usize,
    /// Number of cost evaluations, without those of refinement and comparison.
    pub n_evaluations: usize,
    /// Wall time of the calibration without the comparison of methods, ms.
    pub duration_ms: f64,
    /// Final cost F on the identify subset, mm².
    pub cost_mm2: f64,
    /// Errors of the verified parameters on the points to which they were fitted.
    pub identify: SubsetReport,
    /// Errors of the verified parameters on points to which they were not fitted; null if there are no such points.
    #[schema(required)]
    pub verify: Option<SubsetReport>,
    /// As `verify`, but without the points that a warning lists as outliers. Absent if none of the verify points is an outlier. `verify` includes the
    /// outliers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verify_without_outliers: Option<SubsetReport>,
    /// The fit of the delivered parameters to all points of the upload. Absent if the delivered parameters are the verified ones.
    #[serde(rename = "final", default, skip_serializing_if = "Option::is_none")]
    pub final_fit: Option<FinalFitReport>,
    /// All points of the set in order, then all points of the verify set.
    pub per_point: Vec<PointReport>,
    /// All free parameters.
    pub parameters: Vec<ParameterReport>,
    /// The reference of the instrument; absent if the upload names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<ReferenceReport>,
    /// Predicted uncertainty of the tool's position over the workspace, for the links alone and the scale of the instrument. It includes the errors that
    /// kept corrections describe, because the links alone have them. Null if it cannot be computed.
    #[schema(required)]
    pub tool_uncertainty_mm: Option<ToolUncertaintyReport>,
    /// The same for predictions and corrected targets, which contain the corrections. Absent without corrections, if it cannot be computed, and in
    /// reports of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool_uncertainty_corrected_mm: Option<ToolUncertaintyReport>,
    /// Reason why neither the tool nor any parameter has an uncertainty. Absent if they have one, or if no parameters were identified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool_uncertainty_absent_because: Option<String>,
    /// One standard deviation of the flange's rotation relative to the robot's base over the workspace, degrees, with general priors for robots. It
    /// contains the part that the positions do not determine, the distance of the identified links from the best estimate, and the zero of the last
    /// joint. Above 0.5°, compensation of poses and of tools other than a measured reflector is refused (`orientation_not_known`). Null if it cannot
    /// be computed; absent in reports of older versions.
    #[serde(default)]
    pub flange_rotation_std_deg: Option<f64>,
    /// The part of `flange_rotation_std_deg` that position measurements cannot determine: the zero of the last joint, degrees. Its standard deviation
    /// is estimated from the identified zeros of the other joints, or taken from a prior. If the rest of the rotation is above 0.5°, implausible
    /// changes cannot be released even with a `change_reason`. Null if it cannot be computed; absent in reports of older versions.
    #[serde(default)]
    pub last_joint_zero_std_deg: Option<f64>,
    /// Scatter of the points about the model; null if it cannot be computed.
    #[schema(required)]
    pub error_model: Option<ErrorModelReport>,
    /// Identifiability: which parameters the data determine.
    pub identifiability: IdentifiabilityReport,
    /// Results of other methods on the same points.
    pub comparison: Vec<ComparisonReport>,
    /// Corrections that were tried, in order. Empty if the link parameters leave no error to explain, or if there are too few points for a decision.
    /// Absent if the job did not search for corrections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<Vec<CorrectionReport>>,
    /// Repeatability at poses that were measured several times; absent if there are no such poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability: Option<RepeatabilityReport>,
    /// Significant changes since the session of the robot's last identification: first the robot's parameters, then base and targets. Empty if no
    /// change is significant; absent if there was no session to compare with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed: Option<Vec<ChangeReport>>,
    /// The sessions that were fitted together; absent if the job has one measurement set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pooled: Option<PooledReport>,
    /// Whether the released parameter set is still valid; only for jobs of kind `check`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub check: Option<CheckReport>,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// SHA-256 of the canonical content, without identifiers, times, durations and comparisons with earlier sessions. The same request, seed and
    /// version give the same hash.
    pub result_sha256: String,
}

/// The errors of one point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PointReport {
    /// Its configuration.
    pub configuration: String,
    /// Its name in the file; absent if the file names no points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its target.
    pub target: usize,
    /// Its subset.
    pub subset: Subset,
    /// Position error of the nominal robot, mm.
    pub before_mm: f64,
    /// Position error of the robot with the identified links, mm.
    pub after_mm: f64,
    /// Position error of the robot with the identified links and corrections, mm. Equal to `after_mm` if no correction is used; absent if the job did
    /// not search for corrections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_mm: Option<f64>,
    /// Measured position in the measuring frame, mm. Absent in reports of older versions, as are the other vectors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
    /// Residual of the nominal robot (measured − predicted), in the measuring frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before_vector_mm: Option<[f64; 3]>,
    /// Residual of the robot with the identified links (measured − predicted), in the measuring frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_vector_mm: Option<[f64; 3]>,
    /// Residual of the robot with links and corrections (measured − predicted), in the measuring frame, mm. Present if `corrected_mm` is present.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_vector_mm: Option<[f64; 3]>,
    /// For a pose: angle between the measured orientation and that of the nominal robot, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before_rotation_deg: Option<f64>,
    /// For a pose: angle between the measured orientation and that of the identified robot, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_rotation_deg: Option<f64>,
    /// True if a warning lists the point as an outlier. Comparisons leave such a point out. Absent if false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub outlier: bool,
}

/// One standard deviation of the tool's 3-D position with the link parameters only, at random configurations within the joint limits. A joint without
/// limits covers its measured range, at least half a turn. The uncertainty includes noise, combinations of parameters that the data do not determine,
/// and misfit of the model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ToolUncertaintyReport {
    /// Mean, mm.
    pub mean: f64,
    /// Largest, mm.
    pub max: f64,
}

/// Result of another method on the same points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComparisonReport {
    /// `least_squares`, `pso`, `warm_start`, ….
    pub method: String,
    /// Number of iterations.
    pub n_iterations: usize,
    /// Number of cost evaluations.
    pub n_evaluations: usize,
    /// Wall time, ms.
    pub duration_ms: f64,
    /// F on the identify subset, mm².
    pub cost_mm2: f64,
    /// Errors on the verify subset; null if there is none.
    #[schema(required)]
    pub verify_after: Option<ErrorsReport>,
}

/// Strength of the verification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// No held-out point counts as evidence.
    None,
    /// Verified on points of the same upload.
    SameUpload,
    /// Verified on another measuring session.
    IndependentSession,
}

names!(Evidence {
    None = "none", SameUpload = "same_upload", IndependentSession = "independent_session",
});

/// Convergence of the cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Convergence {
    /// Number of the iteration; 0 is the start.
    pub iteration: Vec<usize>,
    /// Smallest cost F up to this iteration, mm².
    pub best_cost_mm2: Vec<f64>,
}
