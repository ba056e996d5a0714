//! Result of a calibration as plain data. Its parts are those of the report of the API: they derive its JSON and its schema, so their documentation is
//! that of `openapi.yaml`. `wire::report` joins them to the report of a job.

use crate::calibration::point_errors::PointErrors;
use crate::calibration::quick_check::QuickCheck;
use crate::calibration::reference::ScaleAtReach;
use crate::calibration::request::{Method, Model, Preset};
pub use crate::calibration::warning::Warning;
use crate::identification::TrainedNetwork;
use crate::identification::corrections::Evidence;
use crate::identification::corrections::corrected::CorrectedModel;
use crate::identification::statistics::estimate::Estimate;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::identification::statistics::workspace::ToolUncertainty;
use crate::kinematics::Link;
use crate::measurement::Subset;
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// Mean, standard deviation, root mean square and maximum of the 3-D position errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ErrorsReport)]
pub struct Errors {
    /// Mean, mm.
    pub mean_mm: f64,
    /// Population standard deviation, mm.
    pub std_mm: f64,
    /// Root mean square, mm.
    pub rms_mm: f64,
    /// Largest, mm.
    pub max_mm: f64,
}

/// Errors of one subset of the points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = SubsetReport)]
pub struct SubsetErrors {
    /// Number of points in the subset.
    pub n_points: usize,
    /// Errors of the nominal robot.
    pub before: Errors,
    /// Errors of the robot with the identified links, without corrections.
    pub after: Errors,
    /// Errors of the robot with the identified links and corrections. Equal to `after` if no correction is used; absent if the job did not search for
    /// corrections.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<Errors>,
    /// Rotation errors of the poses; absent if only positions were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<RotationErrorsOfBoth>,
}

/// Rotation errors: angles between measured and predicted orientations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = RotationReport)]
pub struct RotationErrorsOfBoth {
    /// Number of poses in the subset.
    pub n_poses: usize,
    /// Errors of the nominal robot.
    pub before: RotationErrors,
    /// Errors of the robot with the identified links, without corrections.
    pub after: RotationErrors,
    /// Errors of the identified robot with corrections; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected: Option<RotationErrors>,
}

/// Mean, root mean square and maximum of the angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = RotationErrorsReport)]
pub struct RotationErrors {
    /// Mean, degrees.
    pub mean_deg: f64,
    /// Root mean square, degrees.
    pub rms_deg: f64,
    /// Largest, degrees.
    pub max_deg: f64,
}

impl SubsetErrors {
    /// The larger of two errors: with the links alone, and with corrections. Either model may be used to move the robot.
    pub fn worse(&self) -> Errors {
        self.corrected
            .filter(|corrected| corrected.rms_mm > self.after.rms_mm)
            .unwrap_or(self.after)
    }
}

/// The delivered parameters, compared with those that were verified.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = FinalFitReport)]
pub struct FinalErrors {
    /// Number of points to which the delivered parameters were fitted.
    pub n_points: usize,
    /// Root mean square error of these points with the link parameters only, mm.
    pub rms_mm: f64,
    /// Mean distance between the tool positions with the delivered and with the verified parameters, at 200 configurations over the workspace, mm.
    pub moved_mm: f64,
}

/// Result for one parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ParameterReport)]
pub struct ParameterOutcome {
    /// `a_1`, `theta_offset_3`, `base_x`, ….
    pub name: String,
    /// For link parameters: number of the link, 1-based.
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
    /// One standard deviation; null if it cannot be computed.
    #[schema(required)]
    pub std_uncertainty: Option<f64>,
    /// Interval that contains the true value with 95 % probability, in the same unit; null if it cannot be computed.
    #[schema(required)]
    pub interval_95: Option<[f64; 2]>,
    /// Share of the knowledge about the parameter that comes from the data: 1 − posterior variance / prior variance. Absent in reports of older
    /// versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub data_share: Option<f64>,
    /// True if `data_share` is at least half.
    pub identifiable: bool,
    /// The prior that the request gave for this parameter, and its influence on the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorOutcome>,
}

/// A prior as it was used, in the parameter's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = PriorReport)]
pub struct PriorOutcome {
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
    /// Share of the information about the parameter that comes from its prior, 0 to 1; null if no uncertainty can be computed.
    #[schema(required)]
    pub share: Option<f64>,
    /// `min` or `max` if the fit ended at that bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_bound: Option<String>,
}

/// Scatter of the points about the model, one standard deviation each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ErrorModelReport)]
pub struct ErrorModel {
    /// White noise of one coordinate, mm.
    pub noise_std_mm: f64,
    /// Error that is common to all points of one configuration, mm; 0 if it cannot be distinguished from noise.
    pub configuration_std_mm: f64,
    /// Misfit: error that the model cannot describe, expressed as a rotation of each joint that depends on its value and on gravity, degrees. 0 if it
    /// cannot be distinguished from noise.
    pub misfit_std_deg: f64,
}

impl ErrorModel {
    /// The part of an uncertainty that is reported.
    pub fn of(uncertainty: &Uncertainty) -> Self {
        let Uncertainty {
            noise_std_mm,
            configuration_std_mm,
            misfit_std_rad,
            ..
        } = *uncertainty;
        Self {
            noise_std_mm,
            configuration_std_mm,
            misfit_std_deg: misfit_std_rad.to_degrees(),
        }
    }
}

/// Identifiability: which parameters the data determine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = IdentifiabilityReport)]
pub struct Identifiability {
    /// Number of free parameters.
    pub n_parameters: usize,
    /// Rank of the scaled identification Jacobian: number of parameter combinations that the points determine, without priors.
    pub rank: usize,
    /// Number of parameter combinations that only priors determine; absent without priors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_by_priors: Option<usize>,
    /// Condition number: ratio of the largest to the smallest singular value of the combinations that the points determine; null if it exceeds the
    /// range of a float.
    #[schema(required)]
    pub condition_number: Option<f64>,
    /// Parameter combinations that the data do not determine. Each is a list of parameter names.
    pub unidentifiable: Vec<Vec<String>>,
    /// Observability index O1 of the scaled Jacobian; null if it exceeds the range of a float.
    #[schema(required)]
    pub observability_index_o1: Option<f64>,
}

/// Another method on the same points. The service measures its duration from the start and end of its stage.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodComparison {
    /// `least_squares`, `pso`, `bpnn_pso`, `warm_start`.
    pub method: &'static str,
    /// Name of the stage ([`crate::calibration::Event`]) that runs this method.
    pub stage: &'static str,
    /// Iterations it took.
    pub n_iterations: usize,
    /// Cost (or residual) evaluations it took.
    pub n_evaluations: usize,
    /// F on the identify subset, mm².
    pub cost_mm2: f64,
    /// Errors on the verify subset.
    pub verify_after: Option<Errors>,
}

/// Uncertainty of the flange's rotation in the robot's base, over the workspace: one standard deviation each, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangeRotation {
    /// Without the zero of the last joint. A reflector off the last axis, and poses that move every joint, would determine this part.
    pub by_positions_rad: f64,
    /// Uncertainty of the zero of the last joint, about the last axis.
    pub last_joint_zero_rad: f64,
}

impl FlangeRotation {
    /// Both parts combined.
    pub fn std_rad(&self) -> f64 {
        libm::hypot(self.by_positions_rad, self.last_joint_zero_rad)
    }
}

/// The outcome of one calibration. The default is a verification, which identifies nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationReport {
    /// The method that ran (never `Auto`).
    pub method: Method,
    /// Reason for the choice of this method.
    pub method_reason: String,
    /// The model that was identified.
    pub model: Model,
    /// The preset.
    pub preset: Preset,
    /// The seed.
    pub seed: u64,
    /// Why the main method stopped (`iteration_limit`, `cost_reached`, `converged`, …).
    pub termination: &'static str,
    /// Swarm updates (or least-squares steps); refine and comparison not counted.
    pub n_iterations: usize,
    /// Cost evaluations; refine and comparison not counted.
    pub n_evaluations: usize,
    /// F of the final model on the identify subset, mm².
    pub cost_mm2: f64,
    /// Smallest F after each iteration of the main method, index 0 = the start, mm².
    pub convergence_mm2: Vec<f64>,
    /// Errors of the identify subset.
    pub identify: SubsetErrors,
    /// Errors of the verify subset, if there is one.
    pub verify: Option<SubsetErrors>,
    /// Errors of the verify subset without outliers; `None` if it has none.
    pub verify_without_outliers: Option<SubsetErrors>,
    /// Errors of the delivered fit; `None` if the verified parameters themselves are delivered.
    pub final_fit: Option<FinalErrors>,
    /// Every point of the set (and of the verify set, after them), in order.
    pub per_point: Vec<PointErrors>,
    /// Every free parameter.
    pub parameters: Vec<ParameterOutcome>,
    /// Predicted uncertainty of the tool's position over the workspace, from the links and the scale of the instrument, if it can be stated.
    pub tool_uncertainty: Option<ToolUncertainty>,
    /// The same for predictions with corrections, if some were kept.
    pub corrected_tool_uncertainty: Option<ToolUncertainty>,
    /// The scale of the instrument, if lengths with a certificate were measured with it.
    pub instrument_scale: Option<ScaleAtReach>,
    /// How the points scatter about the model, if it can be stated.
    pub error_model: Option<ErrorModel>,
    /// The full uncertainty, with the covariance: rows in the order of `parameters`.
    pub uncertainty: Option<Uncertainty>,
    /// Estimate of the delivered fit, for comparison with later sessions. `None` if priors were stated, if there is no fit to all points, or
    /// if its uncertainty cannot be stated.
    pub estimate: Option<Estimate>,
    /// Why no uncertainty is stated, if a robot was identified without one.
    pub uncertainty_absent_because: Option<String>,
    /// What changed since the robot's last identification, if that was given.
    pub changes: Option<Changes>,
    /// Uncertainty of the flange's rotation in the robot's base; `None` if it cannot be computed.
    pub flange_rotation: Option<FlangeRotation>,
    /// What the data determine.
    pub identifiability: Identifiability,
    /// Rank of the identification Jacobian at generic poses. Positions cannot determine more.
    pub model_rank: usize,
    /// Other methods on the same points.
    pub comparison: Vec<MethodComparison>,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// Identified links.
    pub links: Vec<Link>,
    /// Measuring frame to base; identity for `model: paper` on frame=base.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Target positions in the flange frame, mm: first the last segment of every target, then the earlier segments of those that moved.
    pub targets_mm: Vec<Vector3<f64>>,
    /// Rotation of each target in the flange frame, if poses were measured.
    pub target_rotations: Vec<Rotation3<f64>>,
    /// (target, segment) of each target; segments count from 0.
    pub target_segments: Vec<(usize, usize)>,
    /// The robot with corrections, if some were kept. Its targets are in the order of `targets_mm`.
    pub corrected: Option<CorrectedModel>,
    /// Repeatability at poses that were measured several times; `None` if there are none.
    pub repeatability: Option<Repeatability>,
    /// Corrections that were tried, and their effect; `None` if none were searched.
    pub corrections: Option<Vec<Evidence>>,
    /// The sessions that were fitted together; `None` for a single upload.
    pub pooled: Option<PooledSessions>,
    /// Whether the released set is still valid; only for a quick check.
    pub quick_check: Option<QuickCheck>,
    /// The network trained on this run, if it was a swarm.
    pub network: Option<TrainedNetwork>,
}

/// Sessions that were fitted together, and the comparison of the two sessions that differ most.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = PooledReport)]
pub struct PooledSessions {
    /// Each session, in the order of `measurement_set_ids`.
    pub sessions: Vec<PooledSession>,
    /// Test statistic of the two sessions that differ most: squared difference, normalised by its covariance.
    pub chi_square: f64,
    /// Number of parameter combinations that both of these sessions determine.
    pub n_combinations: usize,
    /// p-value: probability that sessions of an unchanged robot differ at least as much.
    pub probability: f64,
    /// Names of the targets that at least two sessions share; absent if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_targets: Vec<String>,
}

/// One of the sessions that were fitted together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = PooledSessionReport)]
pub struct PooledSession {
    /// Its first row in the report, 0-based. The rows of the report are numbered continuously over all sets.
    pub first_row: usize,
    /// Number of its points.
    pub n_points: usize,
    /// Noise of one coordinate in this session, mm. Its points are weighted with it. Absent if all sessions have the same weight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_std_mm: Option<f64>,
    /// Root mean square error of its identify points with the link parameters only, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub identify_rms_mm: Option<f64>,
    /// Root mean square error of its verify points with the link parameters only, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verify_rms_mm: Option<f64>,
}

/// Warning: the session's poses show too little of the robot to be evidence.
pub const SHOWS_LITTLE: &str = "session_shows_little";
/// Warning: the set was identified in the base frame, but the points were scored with a base fitted to them.
pub const BASE_NOT_CHECKED: &str = "base_not_checked";
/// Warning: there are few points for the number of fitted base and target parameters.
pub const FEW_VERIFY_POINTS: &str = "few_verify_points";
/// Minimum number of configurations for evidence, however often each was read.
pub const MIN_TO_PROVE: usize = 5;

impl CalibrationReport {
    /// True if the verify points are evidence for a release: they fit the robot, are numerous enough, and are not those of a quick check.
    pub fn is_evidence(&self) -> bool {
        let mut says_nothing = vec![DOES_NOT_FIT, NO_FIT, FEW_VERIFY_POINTS, SHOWS_LITTLE];
        // An identifying job has fitted its own base, so such points are as good as those held out of the same upload.
        if self.identify.n_points == 0 {
            says_nothing.push(BASE_NOT_CHECKED);
        }
        let to_verify = self.per_point.iter();
        let to_verify = to_verify.filter(|point| point.subset == Subset::Verify);
        let configurations: BTreeSet<&str> = to_verify
            .map(|point| point.configuration.as_str())
            .collect();
        self.quick_check.is_none()
            && configurations.len() >= MIN_TO_PROVE
            && self
                .warnings
                .iter()
                .all(|warning| !says_nothing.contains(&warning.code))
    }
}

/// Repeatability by ISO 9283, from poses that were measured several times (joint values equal within 0.05°, same target, without outliers). The
/// standard requires 30 visits. With few visits RP is too small, but `std_mm` is still correct.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = RepeatabilityReport)]
pub struct Repeatability {
    /// Number of poses that were visited more than once.
    pub n_poses: usize,
    /// Number of points at these poses.
    pub n_points: usize,
    /// Pose repeatability RP of all poses together, mm: mean + 3 standard deviations of the distance from the pose's barycentre.
    pub rp_mm: f64,
    /// Standard deviation of one coordinate about the pose's barycentre, mm.
    pub std_mm: f64,
    /// The results for each of these poses.
    pub poses: Vec<PoseRepeatability>,
}

/// One revisited pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = PoseRepeatabilityReport)]
pub struct PoseRepeatability {
    /// Its configuration.
    pub configuration: String,
    /// Name of its first point in the file; absent if the file names no points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its target.
    pub target: usize,
    /// Number of visits.
    pub n: usize,
    /// Data rows of the visits, 0-based.
    pub rows: Vec<usize>,
    /// RP of this pose, mm.
    pub rp_mm: f64,
    /// Pose accuracy AP of the nominal robot, mm: distance between the barycentre and the position that the nominal robot predicts.
    pub ap_before_mm: f64,
    /// AP of the robot with the identified links, mm.
    pub ap_after_mm: f64,
    /// AP of the robot with links and corrections, mm; absent if no correction is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ap_corrected_mm: Option<f64>,
}

/// How a robot changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChangeKind {
    /// Small changes: wear, temperature, settling.
    Drift,
    /// A jump in few parameters.
    Collision,
    /// Jumps in many parameters: parts exchanged, or another robot.
    Rebuilt,
}

/// Changes, as reported.
#[derive(Clone, Debug, PartialEq)]
pub struct Changes {
    /// The robot's parameters first, then base and targets.
    pub all: Vec<NamedChange>,
    /// Kind of change of the robot; `None` if it has not changed.
    pub kind: Option<ChangeKind>,
    /// Warnings about the changes.
    pub warnings: Vec<Warning>,
    /// dᵀ·V⁻¹·d of the robot's own parameters.
    pub chi_square: f64,
    /// Number of combinations of these parameters that both sessions determine.
    pub n_combinations: usize,
    /// Probability that an unchanged robot gives at least this value.
    pub probability: f64,
}

/// A parameter that changed since the previous session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = ChangeReport)]
pub struct NamedChange {
    /// The parameter. Several names joined by "or" if positions cannot tell these parameters apart.
    pub name: String,
    /// Change, mm or degrees: current value − earlier value.
    pub delta: f64,
    /// |delta| divided by its standard uncertainty.
    pub sigmas: f64,
}

/// Warning: a file does not fit the robot.
pub const DOES_NOT_FIT: &str = "session_does_not_fit";

/// Warning: the identified robot does not fit its own points.
pub const NO_FIT: &str = "no_fit";
