//! Uncertainty of the flange's rotation of the identified robot, including prior knowledge of robots.
//!
//! Positions of one reflector on the last axis hardly determine the rotation of the flange; priors determine the rest. The reference is the
//! maximum a posteriori estimate from the nominal robot, with base and targets free. The expected squared error of the identified robot is
//! the posterior variance plus the squared distance between the identified robot and that estimate: E|R_identified − R_true|² =
//! E|R_posterior − R_true|² + |R_identified − R_posterior|². The second part is the identification's own choice along combinations that the
//! positions do not determine.
//!
//! If the last link is found longer than robots are built, an unmastered joint before it may explain the points as well. The rotation
//! between the two explanations is then included.
//!
//! Positions never determine the zero of the last joint, because another place of the reflector on the flange explains them as well. This
//! zero is known only by its prior, whose width comes from the zeros of the other joints or from the request.

use crate::calibration::preparation::arrangement::MIN_OF_SETUP;
use crate::calibration::preparation::observe::with_target_rotations;
use crate::calibration::problem;
use crate::calibration::report::{FlangeRotation, Warning};
use crate::calibration::solve::most_probable::HELD;
use crate::calibration::warnings::unobservable::{N_CONFIGURATIONS, at_flange};
use crate::compensation::anchor;
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::{Estimate, estimate};
use crate::identification::least_squares::evidence::Noise;
use crate::identification::least_squares::problem::{Kind, Prior, Problem, Unknown, Variable};
use crate::identification::least_squares::start::fit_base_and_targets;
use crate::identification::model::objective::{Observation, with_weight};
use crate::identification::model::parameters::{Parameter, Quantity, complete_parameters};
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Link, t_base_flange};
use std::ops::ControlFlow;

/// Maximum number of points. More points are thinned out, because they could only reduce the uncertainty.
const MAX_POINTS: usize = 2_000;

/// A length is implausible if it deviates from its drawing by more than this number of standard deviations of new robots.
const IMPLAUSIBLE: f64 = 2.0;

/// Weight of the prior of the variance of joint zeros, as a number of zeros.
const PRIOR_ZEROS: f64 = 2.0;

/// Uncertainty of the flange's rotation: the largest for the given links, each identified from the points of the problem. `None` if it cannot be
/// computed.
pub fn flange_rotation(
    problem: &problem::Problem<'_>,
    model: &KinematicModel,
    links: &[&[Link]],
) -> Option<FlangeRotation> {
    let robot = &problem.request.robot;
    let n_targets = problem.screening.targets.len();
    let observations = thinned(problem.loss.reweighted(model, &problem.identify));
    if observations.is_empty() {
        return None;
    }
    let parameters = with_target_rotations(
        complete_parameters(robot.links.len(), n_targets),
        &observations,
    );
    let nominal = fit_base_and_targets(&robot.links, &observations, n_targets);
    let mut points = Problem::new(nominal, &parameters, &observations)
        .with_stations(&observations, MIN_OF_SETUP);
    points.least_sigma_mm = problem.least_sigma_mm.unwrap_or(points.least_sigma_mm);
    state_priors_of_links(problem, &parameters, &mut points);
    let start = vec![0.0; points.variables.len()];
    let found = estimate(&points, &start, 0.0, &mut |_| ControlFlow::Continue(()));
    let as_drawn = with_the_last_link_as_drawn(&points, &found);
    let root = points.in_units(found.posterior.root.clone());
    let root = root.rows(0, parameters.len()).into_owned();
    let estimate = &found.model;
    let posterior_rad = at_flange(robot, estimate, &parameters, &[&root]).turn_rad;
    let away_rad = links
        .iter()
        .flat_map(|links| {
            let other = as_drawn.as_ref().map(|model| &model.links);
            let others = std::iter::once(&estimate.links).chain(other);
            others.map(|other| turned_rad(problem, links, other))
        })
        .fold(0.0, f64::max);
    let last_zero = Parameter::Link(robot.links.len() - 1, Quantity::ThetaOffset);
    let last_zero = parameters.iter().position(|p| *p == last_zero)?;
    let variable = &points.variables[last_zero];
    let by_the_other_zeros_rad = match variable.prior {
        Prior::OfKind(Kind::Offset) => variable.width * rms_zero(&points, &found),
        _ => 0.0,
    };
    let rotation = FlangeRotation {
        by_positions_rad: libm::hypot(posterior_rad, away_rad),
        last_joint_zero_rad: root.row(last_zero).norm().max(by_the_other_zeros_rad),
    };
    rotation.std_rad().is_finite().then_some(rotation)
}

/// Expected root mean square error of a joint zero of this robot that no row determines, in widths of the prior.
///
/// The zeros are taken as normal with an unknown variance. Its prior is an inverse gamma distribution with mean 1 and the weight of
/// [`PRIOR_ZEROS`] zeros; the result is the root of its posterior mean. The width of Student's t in [`crate::identification::least_squares::evidence`]
/// is smaller: it leaves out the largest zeros, which is right for the fit of those zeros, but not for a zero that is not measured.
fn rms_zero(points: &Problem<'_>, found: &Estimate) -> f64 {
    let (mut squares, mut determined) = (PRIOR_ZEROS, PRIOR_ZEROS);
    for (j, variable) in points.variables.iter().enumerate() {
        if variable.prior == Prior::OfKind(Kind::Offset) {
            squares += found.x[j] * found.x[j];
            determined += found.posterior.data_share[j];
        }
    }
    (squares / determined).sqrt()
}

/// The estimate with `a` of the last link as drawn. `None` unless that length was found off by more than [`IMPLAUSIBLE`] and the points fit as well
/// with the drawn length.
fn with_the_last_link_as_drawn(points: &Problem<'_>, found: &Estimate) -> Option<KinematicModel> {
    let last = found.model.links.len() - 1;
    let is_length =
        |v: &Variable| v.unknown == Unknown::Parameter(Parameter::Link(last, Quantity::A));
    let at = points.variables.iter().position(is_length)?;
    if found.x[at].abs() < IMPLAUSIBLE {
        return None;
    }
    let mut as_drawn = points.clone();
    as_drawn.state(at, 0.0, HELD * points.variables[at].width);
    let start = vec![0.0; found.x.len()];
    let alone = estimate(&as_drawn, &start, 0.0, &mut |_| ControlFlow::Continue(()));
    let noise = |of: &Estimate| Noise::of(points, &of.evidence, &of.posterior);
    (!noise(&alone).is_more_than(&noise(found))).then_some(alone.model)
}

/// States the request's priors of links in a problem with other parameters.
fn state_priors_of_links(
    problem: &problem::Problem<'_>,
    parameters: &[Parameter],
    points: &mut Problem<'_>,
) {
    for prior in problem.priors.iter().flat_map(|known| &known.priors.all) {
        let stated = &problem.parameters[prior.parameter];
        if let Some(at) = parameters
            .iter()
            .position(|p| p == stated && stated.is_link())
        {
            points.state(at, prior.mean, prior.std);
        }
    }
}

/// Code of the refusals, and of the warning.
pub const NOT_KNOWN: &str = "orientation_not_known";
/// Above this limit, the orientation counts as not known: 0.5°.
pub const MAX_FLANGE_ROTATION_STD_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Warning if the orientation is not known, or if its uncertainty could not be computed, for points that fit.
pub fn warning(flange_rotation: Option<FlangeRotation>, n_links: usize) -> Option<Warning> {
    let Some(found) = flange_rotation else {
        let detail = "by how much the flange may be turned from where the identified robot has it could not be computed. Corrected targets are given \
                      for the position of a measured reflector alone. Identify all parameters from a reflector off the last axis, or from two";
        return Some(Warning::new(NOT_KNOWN, detail));
    };
    if found.std_rad() <= MAX_FLANGE_ROTATION_STD_RAD {
        return None;
    }
    let std_deg = found.std_rad().to_degrees();
    let detail = if found.by_positions_rad > MAX_FLANGE_ROTATION_STD_RAD {
        format!(
            "the flange may be turned by {std_deg:.2}° (one standard deviation under what is known of robots beforehand: flange_rotation_std_deg) \
             from where the identified robot has it, and the measured positions do not show it. Corrected targets are given for the position of a \
             measured reflector alone, and no reason releases changes that are implausible. Measure a reflector off the last axis, or two, at poses \
             that move every joint"
        )
    } else {
        format!(
            "{}. Corrected targets are given for the position of a measured reflector alone. {}",
            last_joint_zero_unknown(std_deg, n_links),
            last_joint_zero_remedy(n_links)
        )
    };
    Some(Warning::new(NOT_KNOWN, detail))
}

/// Message if the measured positions determine the flange's rotation except for the zero of the last joint.
pub fn last_joint_zero_unknown(std_deg: f64, n_links: usize) -> String {
    format!(
        "the flange may be turned by {std_deg:.2}° (one standard deviation: flange_rotation_std_deg) from where the identified robot has it, above \
         all about its last axis: positions never show the zero of joint {n_links}, and the zeros of the other joints of this robot are off by as \
         much"
    )
}

/// How to make the zero of the last joint known.
pub fn last_joint_zero_remedy(n_links: usize) -> String {
    format!(
        "If that joint was mastered by its marks, identify with the prior {{\"name\": \"theta_offset_{n_links}\", \"std\": …}}"
    )
}

/// Points with nonzero weight, at most [`MAX_POINTS`] of them.
fn thinned(observations: Vec<Observation>) -> Vec<Observation> {
    let with_weight = with_weight(&observations);
    let every = with_weight.len().div_ceil(MAX_POINTS).max(1);
    with_weight.into_iter().step_by(every).collect()
}

/// Root mean square angle between the flanges of two robots on their anchored bases, over the workspace.
fn turned_rad(problem: &problem::Problem<'_>, one: &[Link], other: &[Link]) -> f64 {
    let robot = &problem.request.robot;
    let anchors = [one, other].map(|links| anchor(links, &robot.links));
    let square = |q_controller_rad: Vec<f64>| {
        let q_rad = robot.q_model_rad(&q_controller_rad);
        let a = anchors[0].anchored(&t_base_flange(one, &q_rad));
        let b = anchors[1].anchored(&t_base_flange(other, &q_rad));
        rotation_log(&(b.rotation * a.rotation.inverse())).norm_squared()
    };
    let configurations = random_configurations(robot, N_CONFIGURATIONS, 0);
    (configurations.into_iter().map(square).sum::<f64>() / N_CONFIGURATIONS as f64).sqrt()
}
