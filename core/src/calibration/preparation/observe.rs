//! Converts a request to what is fitted and scored: observations in the model's joint convention, their subsets, and the free parameters.
//! Also places a robot with given links on the observations, by fitting base and targets.

use crate::calibration::request::{CalibrationRequest, Model, ParameterChoice, VerifySource};
use crate::calibration::{Error, unusable};
use crate::identification::KinematicModel;
use crate::identification::least_squares::problem::usual_mm_per_rad;
use crate::identification::least_squares::start::{fit_base_and_targets, fit_targets};
use crate::identification::model::objective::{Observation, posed_targets, with_weight};
use crate::identification::model::parameters::{
    Parameter, complete_parameters, paper_parameters, target_rotation_parameters,
};
use crate::identification::model::pose_rows::MeasuredRotation;
use crate::kinematics::{Link, Robot, reach_mm};
use crate::measurement::{Frame, MeasurementSet, Subset, split};
use nalgebra::{IsometryMatrix3, Matrix3, Point3, Rotation3, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Share of the configurations that is kept for verification by default.
pub const DEFAULT_VERIFY_FRACTION: f64 = 0.5;

/// Points of one set, fitted or scored together.
#[derive(Clone, Debug, PartialEq)]
pub struct Observed {
    /// One per point, in order.
    pub all: Vec<Observation>,
    /// One per point.
    pub subsets: Vec<Subset>,
    /// One per point.
    pub configurations: Vec<String>,
    /// Name of each point that has one in its file.
    pub names: Vec<Option<String>>,
    /// Target of each point as numbered in the file. The fit numbers targets differently if a target moved.
    pub targets: Vec<usize>,
    /// Measured position of each point, mm, before any transform by the fit.
    pub positions_mm: Vec<Vector3<f64>>,
    /// Measured rotation of each point's target, for poses.
    pub rotations: Vec<Option<Rotation3<f64>>>,
    /// Whitening matrix of each point's noise, if the noise is known and differs between directions.
    pub whitenings: Vec<Option<Matrix3<f64>>>,
}

impl Observed {
    fn new(
        request: &CalibrationRequest,
        set: &MeasurementSet,
        to_base: &IsometryMatrix3<f64>,
        subsets: Vec<Subset>,
    ) -> Self {
        let all = observations(&request.robot, set, to_base, &subsets);
        Self {
            subsets,
            configurations: set.points.iter().map(|p| p.configuration.clone()).collect(),
            names: set.points.iter().map(|p| p.name.clone()).collect(),
            targets: all.iter().map(|o| o.target).collect(),
            positions_mm: all.iter().map(|o| o.position_mm).collect(),
            rotations: all.iter().map(|o| Some(o.rotation?.rotation)).collect(),
            whitenings: vec![None; all.len()],
            all,
        }
    }

    /// The observations of one subset.
    pub fn of(&self, subset: Subset) -> Vec<Observation> {
        self.all
            .iter()
            .zip(&self.subsets)
            .filter(|(_, s)| **s == subset)
            .map(|(o, _)| o.clone())
            .collect()
    }

    /// Number of each point's configuration, for the points of one subset. Numbers count from 0 in order of appearance.
    pub fn clusters(&self, subset: Subset) -> Vec<usize> {
        numbered(
            self.configurations
                .iter()
                .zip(&self.subsets)
                .filter(|(_, s)| **s == subset)
                .map(|(configuration, _)| configuration),
        )
    }

    /// The number of every point's configuration.
    pub fn all_clusters(&self) -> Vec<usize> {
        numbered(self.configurations.iter())
    }
}

fn numbered<'a>(labels: impl Iterator<Item = &'a String>) -> Vec<usize> {
    let mut number: BTreeMap<&String, usize> = BTreeMap::new();
    labels
        .map(|label| {
            let next = number.len();
            *number.entry(label).or_insert(next)
        })
        .collect()
}

/// The request's own set, split into subsets.
pub fn observe(request: &CalibrationRequest) -> Result<Observed, Error> {
    let set = &request.set;
    let mut observed = Observed::new(request, set, &to_base(request), subsets(request)?);
    weigh_sessions(request, &mut observed);
    Ok(observed)
}

/// Weighs each session by its own noise. A point's weight is its 1/std² within the session, divided by the session's squared noise,
/// relative to the mean over the fitted points. Poses are weighed later over all sessions, when the noise of position and rotation is
/// known.
fn weigh_sessions(request: &CalibrationRequest, observed: &mut Observed) {
    let noises_mm = &request.session_noise_mm;
    if noises_mm.is_empty() || request.set.has_poses() {
        return;
    }
    let of_session = |(set, noise_mm): (&MeasurementSet, &f64)| -> Vec<f64> {
        let all = weights(set, &vec![Subset::Identify; set.points.len()]);
        all.into_iter()
            .map(|weight| weight / (noise_mm * noise_mm))
            .collect()
    };
    let all: Vec<f64> = request
        .sessions
        .iter()
        .zip(noises_mm)
        .flat_map(of_session)
        .collect();
    let is_fitted = |row: usize| observed.subsets[row] == Subset::Identify;
    let weights = relative_weights(&all, is_fitted);
    for (observation, weight) in observed.all.iter_mut().zip(weights) {
        observation.weight = weight;
    }
}

/// Weights in proportion to precisions (1/variance), with mean 1 over the rows that count; over all rows if none does.
pub(super) fn relative_weights(precisions: &[f64], counts: impl Fn(usize) -> bool) -> Vec<f64> {
    let counted = (0..precisions.len()).filter(|row| counts(*row));
    let mut counted: Vec<f64> = counted.map(|row| precisions[row]).collect();
    if counted.is_empty() {
        counted = precisions.to_vec();
    }
    let mean = counted.iter().sum::<f64>() / counted.len().max(1) as f64;
    precisions.iter().map(|w| w / mean).collect()
}

/// The request's own set, with all points to verify.
pub fn observe_to_verify(request: &CalibrationRequest) -> Observed {
    all_to_verify(request, &request.set, &to_base(request))
}

/// Another set of the same robot, with all points to verify.
pub fn observe_verify_set(request: &CalibrationRequest, set: &MeasurementSet) -> Observed {
    all_to_verify(request, set, &IsometryMatrix3::identity())
}

fn all_to_verify(
    request: &CalibrationRequest,
    set: &MeasurementSet,
    to_base: &IsometryMatrix3<f64>,
) -> Observed {
    let subsets = vec![Subset::Verify; set.points.len()];
    Observed::new(request, set, to_base, subsets)
}

/// Transform from measured positions to the frame of the fit. That is the base frame if sweeps give it, else the measuring frame.
pub(super) fn to_base(request: &CalibrationRequest) -> IsometryMatrix3<f64> {
    match (&request.frames, request.model(), request.set.frame) {
        (Some(frames), Model::Paper, Frame::Instrument) => frames.t_instrument_base.inverse(),
        _ => IsometryMatrix3::identity(),
    }
}

fn observations(
    robot: &Robot,
    set: &MeasurementSet,
    to_base: &IsometryMatrix3<f64>,
    subsets: &[Subset],
) -> Vec<Observation> {
    // Poses are weighed later, when the noise of position and rotation is known.
    let weights = match set.has_poses() {
        true => vec![1.0; set.points.len()],
        false => weights(set, subsets),
    };
    let mm_per_rad = usual_mm_per_rad(reach_mm(&robot.links));
    let observation = |(point, weight): (&crate::measurement::Point, f64)| Observation {
        q_rad: robot.q_model_rad(&point.q_rad),
        position_mm: (to_base * Point3::from(point.position_mm)).coords,
        target: point.target,
        weight,
        whitening: None,
        rotation: point.rotation.map(|rotation| MeasuredRotation {
            rotation: to_base.rotation * rotation,
            mm_per_rad,
            lever_mm: point.lever_mm,
        }),
        station: None,
    };
    set.points.iter().zip(weights).map(observation).collect()
}

/// Stated standard deviation of a coordinate of a point of weight 1, mm; 0 if any point states none.
pub fn stated_scale_mm(set: &MeasurementSet) -> f64 {
    let all: Option<Vec<f64>> = set
        .points
        .iter()
        .map(|p| p.position_std_mm().map(|std| 1.0 / (std * std)))
        .collect();
    all.map_or(0.0, |precisions| {
        (precisions.len() as f64 / precisions.iter().sum::<f64>()).sqrt()
    })
}

/// 1/std² of each point, relative to the mean over the fitted points (over all points if none is fitted). So equal uncertainties do not
/// change F, and verify points have no influence. 1 if no uncertainties are stated.
fn weights(set: &MeasurementSet, subsets: &[Subset]) -> Vec<f64> {
    let all: Option<Vec<f64>> = set
        .points
        .iter()
        .map(|p| p.position_std_mm().map(|std| 1.0 / (std * std)))
        .collect();
    let Some(precisions) = all else {
        return vec![1.0; set.points.len()];
    };
    relative_weights(&precisions, |row| subsets[row] == Subset::Identify)
}

fn subsets(request: &CalibrationRequest) -> Result<Vec<Subset>, Error> {
    let set = &request.set;
    let by_column = || split::by_column(set).map_err(|e| unusable("bad_subset", e.to_string()));
    match request.verify {
        VerifySource::Set(_) => Ok(vec![Subset::Identify; set.points.len()]),
        VerifySource::Subset => by_column(),
        VerifySource::Fraction(fraction) => Ok(split::by_fraction(set, fraction, request.seed)),
        VerifySource::Default if split::has_column(set) => by_column(),
        VerifySource::Default => Ok(split::by_fraction(
            set,
            DEFAULT_VERIFY_FRACTION,
            request.seed,
        )),
    }
}

/// The parameters of the request's model.
pub fn model_parameters(request: &CalibrationRequest, n_targets: usize) -> Vec<Parameter> {
    let links = &request.robot.links;
    match request.model() {
        Model::Paper => paper_parameters(links.len()),
        Model::Complete => complete_parameters(links.len(), n_targets),
    }
}

/// Parameters of a fit to some points: the free ones, and the rotations of targets whose poses were measured.
pub fn with_target_rotations(
    mut parameters: Vec<Parameter>,
    observations: &[Observation],
) -> Vec<Parameter> {
    parameters.extend(target_rotation_parameters(&posed_targets(observations)));
    parameters
}

/// The free parameters: those of the model without those that the request holds.
pub fn free_parameters(
    request: &CalibrationRequest,
    n_targets: usize,
) -> Result<Vec<Parameter>, Error> {
    let model = model_parameters(request, n_targets);
    let names: BTreeSet<String> = model.iter().map(Parameter::name).collect();
    let (ParameterChoice::Hold(asked) | ParameterChoice::Identify(asked)) = &request.parameters
    else {
        return Ok(model);
    };
    if let Some(unknown) = asked.iter().find(|name| !names.contains(*name)) {
        let known = names.into_iter().collect::<Vec<_>>().join(", ");
        return Err(unusable(
            "unknown_parameter",
            format!("parameter {unknown:?} is not in this model; it has {known}"),
        ));
    }
    let keep = |p: &Parameter| match &request.parameters {
        ParameterChoice::Hold(_) => !asked.contains(&p.name()),
        // Base and targets belong to the measurement, not to the robot. They are free unless they are held by name.
        _ => asked.contains(&p.name()) || !p.is_link(),
    };
    let free: Vec<Parameter> = model.into_iter().filter(keep).collect();
    if free.is_empty() {
        return Err(unusable(
            "nothing_to_identify",
            "every parameter is held; leave at least one free",
        ));
    }
    Ok(free)
}

/// The nominal robot in the frame of the fit. With sweeps, z_t is merged into d of the last link [Gao 2018, section 2.2].
pub fn nominal_model(
    request: &CalibrationRequest,
    identify: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    let mut links = request.robot.links.clone();
    let frames = request.frames.as_ref();
    if let (Model::Paper, Some(frames), Some(last)) = (request.model(), frames, links.last_mut()) {
        last.d_mm += frames.z_tool_mm;
    }
    placed(request, links, &with_weight(identify), n_targets)
}

/// A robot with these links. Base and targets are fitted where the request's model and frame leave them unknown.
pub fn placed(
    request: &CalibrationRequest,
    links: Vec<Link>,
    observations: &[Observation],
    n_targets: usize,
) -> KinematicModel {
    match (request.model(), request.set.frame) {
        (Model::Paper, _) => KinematicModel::nominal(&links, n_targets),
        (Model::Complete, Frame::Base) => fit_targets(&links, observations, n_targets),
        (Model::Complete, Frame::Instrument) => {
            fit_base_and_targets(&links, observations, n_targets)
        }
    }
}
