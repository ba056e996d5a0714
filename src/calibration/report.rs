//! What a calibration answers: plain data; `wire::report` gives it its JSON shape.

use crate::calibration::quick_check::QuickCheck;
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
    /// The nominal robot's.
    pub before: Errors,
    /// The identified robot's.
    pub after: Errors,
    /// With corrections, where they were looked for: as `after` where none was kept.
    pub corrected: Option<Errors>,
    /// How far poses are turned from where the robots have them; `None` where positions alone were measured.
    pub rotation: Option<RotationErrorsOfBoth>,
}

/// Rotation errors of the poses of one subset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationErrorsOfBoth {
    /// Poses in the subset.
    pub n_poses: usize,
    /// The nominal robot's.
    pub before: RotationErrors,
    /// The identified robot's.
    pub after: RotationErrors,
    /// Its with corrections, where some were kept.
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
    /// Of the links alone or with corrections, whichever are larger: either may move the robot.
    pub fn worse(&self) -> Errors {
        self.corrected
            .filter(|corrected| corrected.rms_mm > self.after.rms_mm)
            .unwrap_or(self.after)
    }
}

/// The delivered fit, to all points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FinalErrors {
    /// Points that it was fitted to.
    pub n_points: usize,
    /// Root mean square of their |residual| by the links alone, mm.
    pub rms_mm: f64,
    /// Mean distance of the tool from where the verified fit has it, at 200 configurations over the workspace, mm.
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
    /// Where it was measured, in the measuring frame, mm.
    pub position_mm: Vector3<f64>,
    /// Residual (measured − predicted) of the nominal robot, in the measuring frame, mm.
    pub before_vector_mm: Vector3<f64>,
    /// Residual of the identified robot, in the measuring frame, mm.
    pub after_vector_mm: Vector3<f64>,
    /// Residual with corrections, where they were looked for: as that of the links where none was kept.
    pub corrected_vector_mm: Option<Vector3<f64>>,
    /// Angle between the measured target and where the nominal robot, the identified robot and that with its corrections have it, rad, of a pose.
    pub rotation_rad: Option<[f64; 3]>,
    /// A warning names it as an outlier, and outliers are few enough not to count in comparisons.
    pub is_outlier: bool,
}

impl PointErrors {
    /// For [`crate::calibration::robust_comparison`].
    pub fn errors_mm(&self) -> [f64; 3] {
        [
            self.before_mm,
            self.after_mm,
            self.corrected_vector_mm
                .map_or(self.after_mm, |vector| vector.norm()),
        ]
    }
}

/// [`PointErrors::errors_mm`] of the points that count in comparisons.
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
    /// One standard deviation, where it can be stated.
    pub std_uncertainty: Option<f64>,
    /// The interval that holds the true value with 95 % probability, in the same unit, where it can be stated.
    pub interval_95: Option<[f64; 2]>,
    /// 1 − posterior variance / prior variance: how much of what is known comes from the points; 0 to 1.
    pub data_share: f64,
    /// Whether that is at least half.
    pub identifiable: bool,
    /// What was known of it beforehand, and what became of that.
    pub prior: Option<PriorOutcome>,
}

/// A prior and what became of it, in the unit of the wire (mm or deg).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorOutcome {
    /// Where the parameter was expected.
    pub mean: f64,
    /// One standard deviation.
    pub std: f64,
    /// Smallest value allowed.
    pub min: Option<f64>,
    /// Largest value allowed.
    pub max: Option<f64>,
    /// Share of what is known of the parameter that comes from its prior: its variance after, over that of the prior. `None` where no
    /// uncertainty can be stated.
    pub share: Option<f64>,
    /// `min` or `max` where the fit ended at that bound.
    pub at_bound: Option<&'static str>,
}

/// How the points scatter about the model ([`crate::identification::uncertainty`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorModel {
    /// White noise of one coordinate of a point of weight 1, one standard deviation, mm.
    pub noise_std_mm: f64,
    /// What all points of one configuration share, mm; 0 where it does not stand out.
    pub configuration_std_mm: f64,
    /// What the model cannot say: random turning of the joints with their values and with gravity, rad; 0 where it does not stand out.
    pub misfit_std_rad: f64,
}

impl ErrorModel {
    /// The part of an uncertainty that belongs into the report.
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

/// What the data can see.
#[derive(Clone, Debug, PartialEq)]
pub struct Identifiability {
    /// Free parameters.
    pub n_parameters: usize,
    /// Rank of the scaled identification Jacobian.
    pub rank: usize,
    /// The rank that generic poses would have; more is not to be had from positions.
    pub model_rank: usize,
    /// Combinations that the data do not see but priors say something of; `None` without priors.
    pub n_by_priors: Option<usize>,
    /// Largest over smallest seen singular value of the scaled Jacobian.
    pub condition_number: f64,
    /// Combinations that cannot be seen, each by the names that take part in it.
    pub unidentifiable: Vec<Vec<String>>,
    /// O1 = (σ1 … σr)^(1/r) / sqrt(N), of the scaled Jacobian.
    pub observability_index_o1: f64,
}

/// One other method on the same points. Its duration is stamped by the service, which sees the stage begin and end.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodComparison {
    /// `least_squares`, `pso`, `bpnn_pso`, `warm_start`.
    pub method: &'static str,
    /// Name of the stage ([`crate::calibration::Event`]) whose duration is this method's.
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

/// A remark that the reader should not miss.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Stable code.
    pub code: &'static str,
    /// In words.
    pub detail: String,
    /// 0-based data rows it is about, if any.
    pub rows: Vec<usize>,
}

/// How well the flange's rotation in the robot's base is known, over the workspace: one standard deviation each, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangeRotation {
    /// Without the zero of the last joint: what a reflector off the last axis, and poses that move every joint, would show.
    pub by_positions_rad: f64,
    /// The zero of the last joint, about the last axis.
    pub last_joint_zero_rad: f64,
}

impl FlangeRotation {
    /// Both together.
    pub fn std_rad(&self) -> f64 {
        libm::hypot(self.by_positions_rad, self.last_joint_zero_rad)
    }
}

/// The outcome of one calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationReport {
    /// The method that ran (never `Auto`).
    pub method: Method,
    /// Why that method.
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
    /// F on the identify subset after everything, mm².
    pub cost_mm2: f64,
    /// Smallest F after each iteration of the main method, index 0 = the start, mm².
    pub convergence_mm2: Vec<f64>,
    /// The identify half.
    pub identify: SubsetErrors,
    /// The verify half, if there is one.
    pub verify: Option<SubsetErrors>,
    /// The same without the points that are named as outliers; `None` if none of them is.
    pub verify_without_outliers: Option<SubsetErrors>,
    /// The delivered fit; `None` if the parameters that were verified are delivered.
    pub final_fit: Option<FinalErrors>,
    /// Every point of the set (and of the verify set, after them), in order.
    pub per_point: Vec<PointErrors>,
    /// Every free parameter.
    pub parameters: Vec<ParameterOutcome>,
    /// Predicted uncertainty of the tool's position over the workspace, by the links alone, where it can be stated.
    pub tool_uncertainty: Option<ToolUncertainty>,
    /// How the points scatter about the model, where it can be stated.
    pub error_model: Option<ErrorModel>,
    /// The whole of it, for whoever wants the covariance: rows in the order of `parameters`.
    pub uncertainty: Option<Uncertainty>,
    /// The delivered fit as later sessions are compared with it; `None` where priors were stated, where no fit to all points was made, and where its
    /// uncertainty cannot be stated.
    pub estimate: Option<Estimate>,
    /// Why no uncertainty is stated, where a robot was identified and none is.
    pub uncertainty_absent_because: Option<String>,
    /// What changed since the robot's last identification, where that was given.
    pub changes: Option<Changes>,
    /// How well it is known how the flange is turned in the robot's base; `None` where it cannot be computed.
    pub flange_rotation: Option<FlangeRotation>,
    /// What the data can see.
    pub identifiability: Identifiability,
    /// Other methods on the same points.
    pub comparison: Vec<MethodComparison>,
    /// Remarks.
    pub warnings: Vec<Warning>,
    /// Identified links.
    pub links: Vec<Link>,
    /// Measuring frame to base; identity for `model: paper` on frame=base.
    pub t_instrument_base: IsometryMatrix3<f64>,
    /// Target offsets in the flange frame, mm: first every target as it was last, then the earlier segments of those that moved.
    pub targets_mm: Vec<Vector3<f64>>,
    /// How each of them is turned in the flange frame, where poses were measured.
    pub target_rotations: Vec<Rotation3<f64>>,
    /// (target, segment) of each of them; segments count from 0.
    pub target_segments: Vec<(usize, usize)>,
    /// The robot with what its links cannot say, where something of that was kept. Its targets are in the order of `targets_mm`.
    pub corrected: Option<CorrectedModel>,
    /// How well the robot returns to the poses that were measured several times; `None` where none was.
    pub repeatability: Option<Repeatability>,
    /// Which corrections were tried, and what they did; `None` where none was looked for.
    pub corrections: Option<Vec<Evidence>>,
    /// The sessions that were fitted together; `None` where it was one upload.
    pub pooled: Option<PooledSessions>,
    /// Whether the released set still holds; of a quick check alone.
    pub quick_check: Option<QuickCheck>,
    /// The network trained on this run, if it was a swarm.
    pub network: Option<TrainedNetwork>,
}

/// Sessions that were fitted together, and how alike the two are that are least alike.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledSessions {
    /// Each session, in the order of the request.
    pub sessions: Vec<PooledSession>,
    /// dᵀ·V⁻¹·d of the robot's own parameters, of these two.
    pub chi_square: f64,
    /// Combinations of parameters that both see.
    pub n_combinations: usize,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
}

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PooledSession {
    /// Its first row among the rows of all sessions, from 0.
    pub first_row: usize,
    /// Its points.
    pub n_points: usize,
    /// Its own noise by which its points count, of a coordinate of a point of weight 1, mm; `None` where all sessions count alike.
    pub noise_std_mm: Option<f64>,
    /// Root mean square error of the links alone on its points to identify from, mm.
    pub identify_rms_mm: Option<f64>,
    /// And on those to verify, mm.
    pub verify_rms_mm: Option<f64>,
}

/// Warning of a session whose poses show too little of the robot to be evidence.
pub const SHOWS_LITTLE: &str = "session_shows_little";
/// Warning that the set's base is one of the base frame, and the points were scored with a base placed anew.
pub const BASE_NOT_CHECKED: &str = "base_not_checked";
/// Warning that the numbers of base and targets are many for the points that they were fitted to.
pub const FEW_VERIFY_POINTS: &str = "few_verify_points";
/// Fewer configurations than this prove nothing, however often each was read.
pub const FEWEST_TO_PROVE: usize = 5;

impl CalibrationReport {
    /// Whether its points to verify say anything for a release: they fit the robot, are enough, and are not those of a quick check.
    pub fn is_evidence(&self) -> bool {
        let mut says_nothing = vec![DOES_NOT_FIT, NO_FIT, FEW_VERIFY_POINTS, SHOWS_LITTLE];
        // a job that identifies has seen its own base: such points then say as much as those held out of the same upload
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
    /// AP: from the barycentre to where the nominal robot should be, mm.
    pub ap_before_mm: f64,
    /// And to where the identified links put it, mm.
    pub ap_after_mm: f64,
    /// And to where links with corrections put it, mm, where there are some.
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

/// What changed, for the report.
#[derive(Clone, Debug, PartialEq)]
pub struct Changes {
    /// The robot's parameters first, then base and targets.
    pub all: Vec<NamedChange>,
    /// Of the robot; `None` where it has not changed.
    pub kind: Option<ChangeKind>,
    /// In words.
    pub warnings: Vec<Warning>,
    /// dᵀ·V⁻¹·d of the robot's own parameters.
    pub chi_square: f64,
    /// Combinations of them that both sessions see.
    pub n_combinations: usize,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
}

/// One change, in the unit of the wire (mm or deg).
#[derive(Clone, Debug, PartialEq)]
pub struct NamedChange {
    /// Its name; `d_2 or d_3` where positions cannot tell which.
    pub name: String,
    /// By how much: of the first name.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// Warning that a file does not fit the robot.
pub const DOES_NOT_FIT: &str = "session_does_not_fit";

/// Warning that the identified robot does not fit its own points.
pub const NO_FIT: &str = "no_fit";
