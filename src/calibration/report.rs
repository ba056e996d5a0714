//! Result of a calibration as plain data. `wire::report` converts it to JSON.

use crate::calibration::quick_check::QuickCheck;
use crate::calibration::reference::ScaleAtReach;
use crate::calibration::request::{Method, Model, Preset};
use crate::identification::TrainedNetwork;
use crate::identification::changes::Estimate;
use crate::identification::corrected::CorrectedModel;
use crate::identification::corrections::Evidence;
use crate::identification::uncertainty::Uncertainty;
use crate::identification::workspace::ToolUncertainty;
use crate::kinematics::Link;
use crate::measurement::Subset;
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use std::collections::BTreeSet;

/// Mean, standard deviation (population), root mean square and largest of the 3-D position errors, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Mean of |residual|, mm.
    pub mean_mm: f64,
    /// Population standard deviation of |residual|, mm.
    pub std_mm: f64,
    /// Root mean square of |residual|, mm.
    pub rms_mm: f64,
    /// Largest |residual|, mm.
    pub max_mm: f64,
}

/// Errors of one subset before (nominal) and after (identified).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SubsetErrors {
    /// Points in the subset.
    pub n_points: usize,
    /// Errors of the nominal robot.
    pub before: Errors,
    /// Errors of the identified robot.
    pub after: Errors,
    /// Errors with corrections, if they were searched; the same as `after` if none was kept.
    pub corrected: Option<Errors>,
    /// Rotation errors of both robots; `None` if only positions were measured.
    pub rotation: Option<RotationErrorsOfBoth>,
}

/// Rotation errors of the poses of one subset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationErrorsOfBoth {
    /// Poses in the subset.
    pub n_poses: usize,
    /// Rotation errors of the nominal robot.
    pub before: RotationErrors,
    /// Rotation errors of the identified robot.
    pub after: RotationErrors,
    /// Rotation errors of the identified robot with corrections, if some were kept.
    pub corrected: Option<RotationErrors>,
}

/// Angles between measured and predicted targets, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationErrors {
    /// Mean.
    pub mean_rad: f64,
    /// Root mean square.
    pub rms_rad: f64,
    /// Largest.
    pub max_rad: f64,
}

impl SubsetErrors {
    /// The larger errors of two: of the links alone, and with corrections. Either model may be used to move the robot.
    pub fn worse(&self) -> Errors {
        self.corrected
            .filter(|corrected| corrected.rms_mm > self.after.rms_mm)
            .unwrap_or(self.after)
    }
}

/// The delivered fit to all points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinalErrors {
    /// Points that it was fitted to.
    pub n_points: usize,
    /// Root mean square of the |residual| of the links alone on these points, mm.
    pub rms_mm: f64,
    /// Mean distance between the tool of the delivered fit and that of the verified fit, at 200 configurations over the workspace, mm.
    pub moved_mm: f64,
}

/// One point's error before and after.
#[derive(Clone, Debug, PartialEq)]
pub struct PointErrors {
    /// Its configuration.
    pub configuration: String,
    /// Its target.
    pub target: usize,
    /// Its subset.
    pub subset: Subset,
    /// |residual| of the nominal robot, mm.
    pub before_mm: f64,
    /// |residual| of the identified robot, mm.
    pub after_mm: f64,
    /// Measured position, in the measuring frame, mm.
    pub position_mm: Vector3<f64>,
    /// Residual (measured − predicted) of the nominal robot, in the measuring frame, mm.
    pub before_vector_mm: Vector3<f64>,
    /// Residual of the identified robot, in the measuring frame, mm.
    pub after_vector_mm: Vector3<f64>,
    /// Residual with corrections, if they were searched, in the measuring frame, mm; the same as without corrections if none was kept.
    pub corrected_vector_mm: Option<Vector3<f64>>,
    /// For a pose: angles between the measured target and its prediction by the nominal robot, the identified robot, and the robot with corrections,
    /// rad.
    pub rotation_rad: Option<[f64; 3]>,
    /// True if a warning names the point as an outlier, and outliers are few enough to be left out of comparisons.
    pub is_outlier: bool,
}

impl PointErrors {
    /// Errors before, after, and with corrections, mm, as [`crate::calibration::robust_comparison`] takes them.
    pub fn errors_mm(&self) -> [f64; 3] {
        [
            self.before_mm,
            self.after_mm,
            self.corrected_vector_mm
                .map_or(self.after_mm, |vector| vector.norm()),
        ]
    }
}

/// [`PointErrors::errors_mm`] of the points that are not left out of comparisons.
pub fn counted_errors_mm(points: &[PointErrors]) -> Vec<[f64; 3]> {
    let counted = points.iter().filter(|point| !point.is_outlier);
    counted.map(PointErrors::errors_mm).collect()
}

/// One parameter's outcome, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterOutcome {
    /// `a_1`, `theta_offset_3`, `base_x`, `target_0_z`, ….
    pub name: String,
    /// 1-based link, for link parameters.
    pub link: Option<usize>,
    /// `mm` or `deg`.
    pub unit: &'static str,
    /// Nominal (for base and targets: the initial estimate).
    pub nominal: f64,
    /// Identified.
    pub identified: f64,
    /// identified − nominal.
    pub delta: f64,
    /// One standard deviation, if it can be stated.
    pub std_uncertainty: Option<f64>,
    /// The interval that contains the true value with 95 % probability, in the same unit, if it can be stated.
    pub interval_95: Option<[f64; 2]>,
    /// 1 − posterior variance / prior variance: the share of the information that comes from the points; 0 to 1.
    pub data_share: f64,
    /// True if `data_share` is at least one half.
    pub identifiable: bool,
    /// Its stated prior, with the outcome.
    pub prior: Option<PriorOutcome>,
}

/// A prior and its outcome, in the unit of the wire (mm or deg).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorOutcome {
    /// Expected value.
    pub mean: f64,
    /// One standard deviation.
    pub std: f64,
    /// Smallest value allowed.
    pub min: Option<f64>,
    /// Largest value allowed.
    pub max: Option<f64>,
    /// Share of the information that comes from the prior: posterior variance over prior variance. `None` if no uncertainty can be stated.
    pub share: Option<f64>,
    /// `min` or `max` if the fit ended at that bound.
    pub at_bound: Option<&'static str>,
}

/// How the points scatter about the model ([`crate::identification::uncertainty`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorModel {
    /// White noise of one coordinate of a point of weight 1, one standard deviation, mm.
    pub noise_std_mm: f64,
    /// Error that all points of one configuration share, one standard deviation, mm; 0 if it is not significant.
    pub configuration_std_mm: f64,
    /// Misfit of the model: random rotation of the joints that varies with their values and with gravity, rad; 0 if it is not significant.
    pub misfit_std_rad: f64,
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
            misfit_std_rad,
        }
    }
}

/// What the data determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Identifiability {
    /// Free parameters.
    pub n_parameters: usize,
    /// Rank of the scaled identification Jacobian.
    pub rank: usize,
    /// Rank at generic poses. Positions cannot determine more.
    pub model_rank: usize,
    /// Number of combinations that priors determine and the data do not; `None` without priors.
    pub n_by_priors: Option<usize>,
    /// Largest over smallest observable singular value of the scaled Jacobian.
    pub condition_number: f64,
    /// Unobservable combinations, each as the names of its parameters.
    pub unidentifiable: Vec<Vec<String>>,
    /// O1 = (σ1 … σr)^(1/r) / sqrt(N), of the scaled Jacobian.
    pub observability_index_o1: f64,
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

/// A warning in the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Stable code.
    pub code: &'static str,
    /// In words.
    pub detail: String,
    /// 0-based data rows concerned, if any.
    pub rows: Vec<usize>,
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

/// The outcome of one calibration.
#[derive(Clone, Debug, PartialEq)]
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
    /// The delivered fit; `None` if the parameters that were verified are delivered.
    pub final_fit: Option<FinalErrors>,
    /// Every point of the set (and of the verify set, after them), in order.
    pub per_point: Vec<PointErrors>,
    /// Every free parameter.
    pub parameters: Vec<ParameterOutcome>,
    /// Predicted uncertainty of the tool's position over the workspace, from the links and the scale of the instrument, if it can be stated.
    pub tool_uncertainty: Option<ToolUncertainty>,
    /// The scale of the instrument, if lengths with a certificate were measured with it.
    pub instrument_scale: Option<ScaleAtReach>,
    /// How the points scatter about the model, if it can be stated.
    pub error_model: Option<ErrorModel>,
    /// The full uncertainty, with the covariance: rows in the order of `parameters`.
    pub uncertainty: Option<Uncertainty>,
    /// Estimate of the delivered fit, for comparison with later sessions. `None` if priors were stated, if there is no fit to all points, or if its
    /// uncertainty cannot be stated.
    pub estimate: Option<Estimate>,
    /// Why no uncertainty is stated, if a robot was identified without one.
    pub uncertainty_absent_because: Option<String>,
    /// What changed since the robot's last identification, if that was given.
    pub changes: Option<Changes>,
    /// Uncertainty of the flange's rotation in the robot's base; `None` if it cannot be computed.
    pub flange_rotation: Option<FlangeRotation>,
    /// What the data determine.
    pub identifiability: Identifiability,
    /// Other methods on the same points.
    pub comparison: Vec<MethodComparison>,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// Identified links.
    pub links: Vec<Link>,
    /// Measuring frame to base; identity for `model: paper` on frame=base.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Target offsets in the flange frame, mm: first every target as it was last, then the earlier segments of those that moved.
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
    /// Whether the released set still holds; only for a quick check.
    pub quick_check: Option<QuickCheck>,
    /// The network trained on this run, if it was a swarm.
    pub network: Option<TrainedNetwork>,
}

/// Sessions that were fitted together, and the comparison of the two least similar sessions.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledSessions {
    /// Each session, in the order of the request.
    pub sessions: Vec<PooledSession>,
    /// dᵀ·V⁻¹·d of the robot's own parameters, for these two sessions.
    pub chi_square: f64,
    /// Number of parameter combinations that both sessions determine.
    pub n_combinations: usize,
    /// Probability that an unchanged robot gives at least this value.
    pub probability: f64,
}

/// One session of several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PooledSession {
    /// Its first row among the rows of all sessions, from 0.
    pub first_row: usize,
    /// Number of its points.
    pub n_points: usize,
    /// Noise that its points are weighed by, for a coordinate of a point of weight 1, mm; `None` if all sessions count alike.
    pub noise_std_mm: Option<f64>,
    /// Root mean square error of the links alone on its identify points, mm.
    pub identify_rms_mm: Option<f64>,
    /// Root mean square error of the links alone on its verify points, mm.
    pub verify_rms_mm: Option<f64>,
}

/// Warning: the session's poses show too little of the robot to be evidence.
pub const SHOWS_LITTLE: &str = "session_shows_little";
/// Warning: the set was identified in the base frame, but the points were scored with a base placed anew.
pub const BASE_NOT_CHECKED: &str = "base_not_checked";
/// Warning: there are few points for the number of fitted base and target parameters.
pub const FEW_VERIFY_POINTS: &str = "few_verify_points";
/// Minimum number of configurations for evidence, however often each was read.
pub const FEWEST_TO_PROVE: usize = 5;

impl CalibrationReport {
    /// True if the verify points are evidence for a release: they fit the robot, are numerous enough, and are not those of a quick check.
    pub fn is_evidence(&self) -> bool {
        let mut says_nothing = vec![DOES_NOT_FIT, NO_FIT, FEW_VERIFY_POINTS, SHOWS_LITTLE];
        // a job that identifies has fitted its own base: such points are as good as those held out of the same upload
        if self.identify.n_points == 0 {
            says_nothing.push(BASE_NOT_CHECKED);
        }
        let to_verify = self.per_point.iter();
        let to_verify = to_verify.filter(|point| point.subset == Subset::Verify);
        let configurations: BTreeSet<&str> = to_verify
            .map(|point| point.configuration.as_str())
            .collect();
        self.quick_check.is_none()
            && configurations.len() >= FEWEST_TO_PROVE
            && self
                .warnings
                .iter()
                .all(|warning| !says_nothing.contains(&warning.code))
    }
}

/// ISO 9283 figures of a set's revisited poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeatability {
    /// RP over all poses together, mm.
    pub rp_mm: f64,
    /// Standard deviation of one coordinate about its pose's barycentre, mm.
    pub std_mm: f64,
    /// Every pose, in order of its first row.
    pub poses: Vec<PoseRepeatability>,
}

/// One revisited pose of one target.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseRepeatability {
    /// Its configuration.
    pub configuration: String,
    /// Its target.
    pub target: usize,
    /// Its rows.
    pub rows: Vec<usize>,
    /// RP, mm.
    pub rp_mm: f64,
    /// AP: distance from the barycentre to the position of the nominal robot, mm.
    pub ap_before_mm: f64,
    /// AP of the identified links, mm.
    pub ap_after_mm: f64,
    /// AP of the links with corrections, mm, if there are any.
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

/// One change, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct NamedChange {
    /// Its name; `d_2 or d_3` if positions cannot tell them apart.
    pub name: String,
    /// Size of the change, for the first name.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// Warning: a file does not fit the robot.
pub const DOES_NOT_FIT: &str = "session_does_not_fit";

/// Warning: the identified robot does not fit its own points.
pub const NO_FIT: &str = "no_fit";
