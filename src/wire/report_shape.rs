//! The shape of a report.

use crate::wire::check::CheckReport;
use crate::wire::job::{Method, Model, Preset};
use crate::wire::measurement::{Subset, Warning};
use crate::wire::names;
use crate::wire::sessions::PooledReport;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The outcome of one calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// The job.
    pub job_id: String,
    /// The earlier parameter set: the one that was verified, at which parameters were held, or with which `changed` compares. Absent if there
    /// was none, or if the nominal robot was verified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parameter_set_from: Option<String>,
    /// The method that ran.
    pub method: Method,
    /// Why that method.
    pub method_reason: String,
    /// The model that was identified.
    pub model: Model,
    /// The preset.
    pub preset: Preset,
    /// The seed.
    pub seed: u64,
    /// The version of kincal that computed it.
    pub version: String,
    /// Why the main method stopped.
    pub termination: String,
    /// Swarm updates or least-squares steps; refine and comparison not counted.
    pub n_iterations: usize,
    /// Cost evaluations; refine and comparison not counted.
    pub n_evaluations: usize,
    /// Wall time of the whole calibration, comparison not counted, ms.
    pub duration_ms: f64,
    /// F on the identify subset after everything, mm².
    pub cost_mm2: f64,
    /// Errors of the verified parameters on the points to which they were fitted.
    pub identify: SubsetReport,
    /// Their errors on points to which they were not fitted; null if there are none.
    #[schema(required)]
    pub verify: Option<SubsetReport>,
    /// The same without the points that a warning names as outliers; absent if none of them is. `verify` counts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verify_without_outliers: Option<SubsetReport>,
    /// The fit of the delivered parameters to all points of the upload; absent if the parameters that were verified are delivered.
    #[serde(rename = "final", default, skip_serializing_if = "Option::is_none")]
    pub final_fit: Option<FinalFitReport>,
    /// Every point of the set, then of the verify set, in order.
    pub per_point: Vec<PointReport>,
    /// Every free parameter.
    pub parameters: Vec<ParameterReport>,
    /// Predicted uncertainty of the tool's position over the workspace, by the links alone. The errors that the corrections in use describe
    /// are counted; the errors of the corrections themselves are not. Null if it cannot be stated.
    #[schema(required)]
    pub tool_uncertainty_mm: Option<ToolUncertaintyReport>,
    /// Reason why neither the tool nor any parameter has an uncertainty; absent if they have one, or if nothing was identified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool_uncertainty_absent_because: Option<String>,
    /// One standard deviation of the flange's rotation in the robot's base over the workspace, degrees, with general priors on robots. It
    /// contains what the positions do not determine, the distance of the identified links from the best estimate, and the zero of the last
    /// joint. Above 0.5°, corrected poses and other tools than a measured reflector are refused (`orientation_not_known`). Null if it cannot be
    /// computed, absent in reports of older versions.
    #[serde(default)]
    pub flange_rotation_std_deg: Option<f64>,
    /// The part of `flange_rotation_std_deg` about the last axis that positions never show: the zero of the last joint, degrees. It is known as
    /// well as the zeros of the other joints turned out to be, or as a prior on it states. If the rest of the rotation is above 0.5°, no
    /// `change_reason` releases implausible changes. Null if it cannot be computed, absent in reports of older versions.
    #[serde(default)]
    pub last_joint_zero_std_deg: Option<f64>,
    /// Scatter of the points about the model; null if it cannot be stated.
    #[schema(required)]
    pub error_model: Option<ErrorModelReport>,
    /// Identifiability: what the data determine.
    pub identifiability: IdentifiabilityReport,
    /// Other methods on the same points.
    pub comparison: Vec<ComparisonReport>,
    /// Corrections that were tried, in order; empty if the links leave no error to explain or there are too few points to decide, absent if
    /// corrections were not searched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrections: Option<Vec<CorrectionReport>>,
    /// Repeatability at poses that were measured several times; absent if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability: Option<RepeatabilityReport>,
    /// Changes since the session of the robot's last identification: the robot's parameters, then base and targets. Empty if nothing changed
    /// beyond chance; absent if there was no session to compare with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed: Option<Vec<ChangeReport>>,
    /// The sessions that were fitted together; absent if the job has one measurement set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pooled: Option<PooledReport>,
    /// Whether the released set still holds; only of jobs of kind check.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub check: Option<CheckReport>,
    /// Strength of the verification.
    pub evidence: Evidence,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// SHA-256 of the canonical content without identifiers, times, durations and comparisons with earlier sessions: equal for the same
    /// request, seed and version.
    pub result_sha256: String,
}

/// Mean, standard deviation, root mean square and maximum of the 3-D position errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ErrorsReport {
    /// Mean, mm.
    pub mean_mm: f64,
    /// Population standard deviation, mm.
    pub std_mm: f64,
    /// Root mean square, mm.
    pub rms_mm: f64,
    /// Largest, mm.
    pub max_mm: f64,
}

/// Errors of one half of the points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SubsetReport {
    /// Points in it.
    pub n_points: usize,
    /// Of the nominal robot.
    pub before: ErrorsReport,
    /// Of the identified links.
    pub after: ErrorsReport,
    /// Of the links with corrections: as `after` if none is used, absent if corrections were not searched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<ErrorsReport>,
    /// Rotation errors of the poses; absent if positions alone were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<RotationReport>,
}

/// Angles between measured poses and where the robots have them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RotationReport {
    /// Poses in it.
    pub n_poses: usize,
    /// Of the nominal robot.
    pub before: RotationErrorsReport,
    /// Of the identified links.
    pub after: RotationErrorsReport,
    /// Of the identified robot with its corrections, where some were kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<RotationErrorsReport>,
}

/// Mean, root mean square and maximum of the angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RotationErrorsReport {
    /// Mean, degrees.
    pub mean_deg: f64,
    /// Root mean square, degrees.
    pub rms_deg: f64,
    /// Largest, degrees.
    pub max_deg: f64,
}

/// The delivered parameters beside those that were verified.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FinalFitReport {
    /// Points to which they were fitted.
    pub n_points: usize,
    /// Root mean square of the errors of these points, by the links alone, mm.
    pub rms_mm: f64,
    /// Mean distance of the tool from its position by the verified parameters, at 200 configurations over the workspace, mm.
    pub moved_mm: f64,
}

/// One point's error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PointReport {
    /// Its configuration.
    pub configuration: String,
    /// Its target.
    pub target: usize,
    /// Its half.
    pub subset: Subset,
    /// Of the nominal robot, mm.
    pub before_mm: f64,
    /// Of the identified robot, mm.
    pub after_mm: f64,
    /// Of the links with corrections, mm: as `after_mm` if none is used, absent if corrections were not searched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_mm: Option<f64>,
    /// Measured position in the measuring frame, mm. Reports of older versions have no vectors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
    /// Measured − predicted by the nominal robot, in the measuring frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before_vector_mm: Option<[f64; 3]>,
    /// Measured − predicted by the identified robot, in the measuring frame, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_vector_mm: Option<[f64; 3]>,
    /// Measured − predicted by the links with corrections, in the measuring frame, mm; as `corrected_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_vector_mm: Option<[f64; 3]>,
    /// Angle between the measured pose and that of the nominal robot, degrees; absent of a position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before_rotation_deg: Option<f64>,
    /// And that of the identified robot, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_rotation_deg: Option<f64>,
    /// A warning names the point as an outlier, and comparisons leave it out; absent if false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub outlier: bool,
}

/// Result for one parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParameterReport {
    /// `a_1`, `theta_offset_3`, `base_x`, ….
    pub name: String,
    /// 1-based link, for link parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<usize>,
    /// `mm` or `deg`.
    pub unit: String,
    /// Nominal value; for base and targets the first estimate.
    pub nominal: f64,
    /// Identified value.
    pub identified: f64,
    /// identified − nominal.
    pub delta: f64,
    /// One standard deviation; null if it cannot be stated.
    #[schema(required)]
    pub std_uncertainty: Option<f64>,
    /// Interval that contains the true value with 95 % probability, in the same unit; null if it cannot be stated.
    #[schema(required)]
    pub interval_95: Option<[f64; 2]>,
    /// 1 − posterior variance / prior variance: the share of what is known of it that comes from the data. Absent in reports of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub data_share: Option<f64>,
    /// True if `data_share` is at least half.
    pub identifiable: bool,
    /// Its prior, and how much it decided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorReport>,
}

/// A prior as it was used, in the parameter's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PriorReport {
    /// Expected value.
    pub mean: f64,
    /// One standard deviation.
    pub std: f64,
    /// Smallest value allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest value allowed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// Share of the parameter's information that comes from its prior, 0 to 1; null if no uncertainty can be stated.
    #[schema(required)]
    pub share: Option<f64>,
    /// `min` or `max` if the fit ended at that bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_bound: Option<String>,
}

/// One standard deviation of the tool's position (3-D) by the links alone, at random configurations within the joint limits. A joint without
/// limits covers its measured range, at least half a turn. Noise, combinations that the data do not determine, and misfit of the model count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ToolUncertaintyReport {
    /// Mean, mm.
    pub mean: f64,
    /// Largest, mm.
    pub max: f64,
}

/// Scatter of the points about the model, one standard deviation each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ErrorModelReport {
    /// White noise of one coordinate, mm.
    pub noise_std_mm: f64,
    /// Error that all points of one configuration share, mm; 0 if it is not distinguishable from noise.
    pub configuration_std_mm: f64,
    /// Error that the model cannot describe, as a rotation of each joint that depends on its value and on gravity, degrees; 0 if it is not
    /// distinguishable from noise.
    pub misfit_std_deg: f64,
}

/// Identifiability: what the data determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct IdentifiabilityReport {
    /// Free parameters.
    pub n_parameters: usize,
    /// Rank of the scaled identification Jacobian: the combinations that the points determine, without priors.
    pub rank: usize,
    /// Combinations that only priors determined; only with priors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_by_priors: Option<usize>,
    /// Ratio of the largest to the smallest singular value of these combinations; null if it exceeds a float.
    #[schema(required)]
    pub condition_number: Option<f64>,
    /// Combinations that the data do not determine, each as the names of its parameters.
    pub unidentifiable: Vec<Vec<String>>,
    /// O1 of the scaled Jacobian; null if it exceeds a float.
    #[schema(required)]
    pub observability_index_o1: Option<f64>,
}

/// Another method on the same points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComparisonReport {
    /// `least_squares`, `pso`, `warm_start`, ….
    pub method: String,
    /// Iterations it took.
    pub n_iterations: usize,
    /// Cost evaluations it took.
    pub n_evaluations: usize,
    /// Wall time, ms.
    pub duration_ms: f64,
    /// F on the identify subset, mm².
    pub cost_mm2: f64,
    /// Errors on the verify subset; null if there is none.
    #[schema(required)]
    pub verify_after: Option<ErrorsReport>,
}

/// A correction that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CorrectionReport {
    /// `stiffness_2_3` (the two joints that gravity loads most), `stiffness_all`, `base_compliance`, `link_masses`, `link_centres`,
    /// `joint_harmonics`, `residual_network`: the order in which they are tried, each beside those kept before it; `all_together` at last.
    pub kind: String,
    /// True if it is used: the gain exceeds its standard error (twice for `all_together`), and the verify points did not get worse.
    pub kept: bool,
    /// Why it was dropped in spite of its gain: `worse_on_verify_points` if the errors on the verify points are larger with all corrections
    /// than with the links alone. Absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dropped_because: Option<String>,
    /// Cross-validated rms without it, mm.
    pub cross_validated_rms_mm_before: f64,
    /// Cross-validated rms with it, mm.
    pub cross_validated_rms_mm_after: f64,
    /// Mean over configurations of the squared error without it minus that with it, mm².
    pub gain_mm2: f64,
    /// Standard error of that mean, mm².
    pub standard_error_mm2: f64,
}

/// ISO 9283 figures of the poses that were measured several times (same joint values to 0.05°, same target, without outliers). The standard
/// asks for 30 visits. With few, RP is too small; `std_mm` is not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RepeatabilityReport {
    /// Poses that were visited more than once.
    pub n_poses: usize,
    /// Their points.
    pub n_points: usize,
    /// RP = mean + 3 standard deviations of the distance from the pose's barycentre, over all poses together, mm.
    pub rp_mm: f64,
    /// Standard deviation of one coordinate about the pose's barycentre, mm.
    pub std_mm: f64,
    /// All of these poses.
    pub poses: Vec<PoseRepeatabilityReport>,
}

/// One revisited pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PoseRepeatabilityReport {
    /// Its configuration.
    pub configuration: String,
    /// Its target.
    pub target: usize,
    /// Visits.
    pub n: usize,
    /// 0-based data rows.
    pub rows: Vec<usize>,
    /// RP of this pose, mm.
    pub rp_mm: f64,
    /// AP: distance of the barycentre from the position by the nominal robot, mm.
    pub ap_before_mm: f64,
    /// AP of the identified links, mm.
    pub ap_after_mm: f64,
    /// AP of the links with corrections, mm, if corrections are used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ap_corrected_mm: Option<f64>,
}

/// A parameter that changed since the set before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ChangeReport {
    /// The parameter; several names with "or" between them if positions cannot decide which.
    pub name: String,
    /// Change, mm or degrees: now − then.
    pub delta: f64,
    /// |delta| in units of its own uncertainty.
    pub sigmas: f64,
}

/// Strength of the verification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// No point was held out.
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
    /// 0 is the start.
    pub iteration: Vec<usize>,
    /// Smallest F so far, mm².
    pub best_cost_mm2: Vec<f64>,
}
