//! How far the flange may be turned from where the identified robot has it, under what is known of robots beforehand.
//!
//! Positions of one reflector on the last axis hardly show how the flange is turned under it. What they leave open is settled by priors: the
//! estimate of maximum a posteriori from the nominal robot, with base and targets free. The expected square of the error of the identified
//! robot is then the posterior variance, and the square of how far the identified robot is from that estimate:
//! E|R_identified − R_true|² = E|R_posterior − R_true|² + |R_identified − R_posterior|².
//! The second part counts what an identification made of combinations that the positions do not show.

use crate::calibration::identify;
use crate::calibration::report::Warning;
use crate::calibration::unseen::{N_CONFIGURATIONS, at_flange};
use crate::compensation::anchor;
use crate::identification::KinematicModel;
use crate::identification::estimate::estimate;
use crate::identification::objective::Observation;
use crate::identification::parameters::complete_parameters;
use crate::identification::problem::Problem;
use crate::identification::start::fit_base_and_targets;
use crate::identification::workspace::random_configurations;
use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Link, t_base_flange};
use std::ops::ControlFlow;

/// More points than this are thinned out: they could only make the uncertainty smaller.
const MAX_POINTS: usize = 2_000;

/// One standard deviation of the flange's rotation in the robot's base, rad, over the workspace; the largest of those of the given links,
/// each identified from the points of the problem. `None` where it cannot be computed.
pub fn flange_rotation_std_rad(
    problem: &identify::Problem<'_>,
    model: &KinematicModel,
    links: &[&[Link]],
) -> Option<f64> {
    let robot = &problem.request.robot;
    let n_targets = problem.screening.targets.len();
    let observations = thinned(problem.loss.reweighted(model, &problem.identify));
    if observations.is_empty() {
        return None;
    }
    let parameters = complete_parameters(robot.links.len(), n_targets);
    let nominal = fit_base_and_targets(&robot.links, &observations, n_targets);
    let points = Problem::new(nominal, &parameters, &observations);
    let start = vec![0.0; parameters.len()];
    let found = estimate(&points, &start, 0.0, &mut |_| ControlFlow::Continue(()));
    let root = points.in_units(found.posterior.root);
    let estimate = found.model;
    let posterior_rad = at_flange(robot, &estimate, &parameters, &[&root]).turn_rad;
    let away_rad = links
        .iter()
        .map(|links| turned_rad(problem, links, &estimate.links))
        .fold(0.0, f64::max);
    let std_rad = libm::hypot(posterior_rad, away_rad);
    std_rad.is_finite().then_some(std_rad)
}

/// Code of the refusals, and of the warning.
pub const NOT_KNOWN: &str = "orientation_not_known";
/// Larger and the orientation counts as not known: 0.5°.
pub const MAX_FLANGE_ROTATION_STD_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Told where the orientation is not known.
pub fn remark(flange_rotation_std_rad: Option<f64>) -> Option<Warning> {
    let std_rad = flange_rotation_std_rad.filter(|std| *std > MAX_FLANGE_ROTATION_STD_RAD)?;
    let detail = format!(
        "the flange may be turned by {:.2}° (one standard deviation under what is known of robots beforehand: flange_rotation_std_deg) from where \
         the identified robot has it, and the measured positions do not show it. Corrected targets are given for the position of a measured reflector alone, and no reason releases changes that are \
         implausible. Measure a reflector off the last axis, or two, at poses that move every joint",
        std_rad.to_degrees()
    );
    Some(Warning {
        code: "orientation_not_known",
        detail,
        rows: vec![],
    })
}

/// Points that count, no more than [`MAX_POINTS`] of them.
fn thinned(observations: Vec<Observation>) -> Vec<Observation> {
    let counting: Vec<Observation> = observations
        .into_iter()
        .filter(|o| o.weight > 0.0)
        .collect();
    let every = counting.len().div_ceil(MAX_POINTS).max(1);
    counting.into_iter().step_by(every).collect()
}

/// Root mean square of the angle between the flanges of two robots on their anchored bases, over the workspace.
fn turned_rad(problem: &identify::Problem<'_>, one: &[Link], other: &[Link]) -> f64 {
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
