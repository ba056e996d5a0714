//! How far the flange may be turned from where the identified robot has it, under what is known of robots beforehand.
//!
//! Positions of one reflector on the last axis hardly show how the flange is turned under it. What they leave open is settled by priors: the
//! estimate of maximum a posteriori from the nominal robot, with base and targets free. The expected square of the error of the identified
//! robot is then the posterior variance, and the square of how far the identified robot is from that estimate:
//! E|R_identified − R_true|² = E|R_posterior − R_true|² + |R_identified − R_posterior|².
//! The second part counts what an identification made of combinations that the positions do not show.

use crate::calibration::identify::Problem;
use crate::calibration::report::Warning;
use crate::calibration::unseen::{N_CONFIGURATIONS, at_flange};
use crate::compensation::anchor;
use crate::identification::KinematicModel;
use crate::identification::identifiability::{VISIBLE_EFFECT_MM, prior_scale};
use crate::identification::objective::{Observation, cost, weighted_jacobian};
use crate::identification::parameters::{Parameter, Quantity, complete_parameters, deviation_from};
use crate::identification::prior_fit::Fitting;
use crate::identification::priors::{Prior, Priors};
use crate::identification::start::fit_base_and_targets;
use crate::identification::workspace::random_configurations;
use crate::kinematics::rotation::rotation_log;
use crate::kinematics::{Link, t_base_flange};
use crate::solvers::qr::triangularise;
use nalgebra::{DMatrix, Vector3};
use std::ops::ControlFlow;

/// A machined length is off by this, one standard deviation, mm, of an arm that reaches [`REACH_MM`].
const LENGTH_MM: f64 = 0.5;
/// See [`LENGTH_MM`].
const REACH_MM: f64 = 1700.0;
/// An angle between two axes: 0.05°.
const ANGLE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// The mastering of a joint: 0.3°.
const OFFSET_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Nothing is known of base and targets: 10 m, and a turn.
const FLAT_MM: f64 = 1e4;
/// See [`FLAT_MM`].
const FLAT_RAD: f64 = std::f64::consts::TAU;
/// A deviation of so many standard deviations is no error of a robot fresh from the factory: its prior becomes as wide as it.
const SURPRISING: f64 = 3.0;
/// More points than this are thinned out: they could only make the uncertainty smaller.
const MAX_POINTS: usize = 2_000;

/// One standard deviation of the flange's rotation in the robot's base, rad, over the workspace; the largest of those of the given links,
/// each identified from the points of the problem. `None` where it cannot be computed.
pub fn flange_rotation_std_rad(
    problem: &Problem<'_>,
    model: &KinematicModel,
    links: &[&[Link]],
) -> Option<f64> {
    let robot = &problem.request.robot;
    let n_targets = problem.screening.targets.len();
    let observations = thinned(problem.loss.reweighted(model, &problem.identify));
    if observations.is_empty() {
        return None;
    }
    let parameters = complete_parameters(&robot.links, n_targets);
    let nominal = fit_base_and_targets(&robot.links, &observations, n_targets);
    let freedom = (3 * observations.len()).saturating_sub(problem.decomposition.rank());
    let noise_mm = (cost(model, &observations) / freedom.max(1) as f64)
        .sqrt()
        .max(VISIBLE_EFFECT_MM);
    let posterior = Posterior {
        parameters: &parameters,
        nominal: &nominal,
        observations: &observations,
        noise_mm,
    };
    let mut stds = posterior.stated_stds(&robot.links);
    let mut estimate = posterior.estimate(&nominal, &stds);
    let widened = posterior.widened(&estimate, &stds);
    if widened != stds {
        stds = widened;
        estimate = posterior.estimate(&estimate, &stds);
    }
    let root = posterior.root(&estimate, &stds)?;
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
fn turned_rad(problem: &Problem<'_>, one: &[Link], other: &[Link]) -> f64 {
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

/// What points and priors say together.
struct Posterior<'a> {
    parameters: &'a [Parameter],
    nominal: &'a KinematicModel,
    observations: &'a [Observation],
    noise_mm: f64,
}

impl Posterior<'_> {
    /// One standard deviation of what is known of each parameter beforehand, mm or rad.
    fn stated_stds(&self, links: &[Link]) -> Vec<f64> {
        let reach_mm: f64 = links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
        let std = |parameter: &Parameter| match parameter {
            Parameter::Link(_, Quantity::A | Quantity::D) => LENGTH_MM * reach_mm / REACH_MM,
            Parameter::Link(_, Quantity::ThetaOffset) => OFFSET_RAD,
            Parameter::Link(_, Quantity::Alpha | Quantity::Beta) => ANGLE_RAD,
            _ if parameter.is_angle() => FLAT_RAD,
            _ => FLAT_MM,
        };
        self.parameters.iter().map(std).collect()
    }

    /// As stated, or where the estimate deviates by much more, as wide as that.
    fn widened(&self, estimate: &KinematicModel, stds: &[f64]) -> Vec<f64> {
        let wide = |(parameter, std): (&Parameter, &f64)| {
            let size = deviation_from(self.nominal, estimate, parameter).abs();
            if parameter.is_link() && size > SURPRISING * std {
                size
            } else {
                *std
            }
        };
        self.parameters.iter().zip(stds).map(wide).collect()
    }

    /// The estimate of maximum a posteriori.
    fn estimate(&self, start: &KinematicModel, stds: &[f64]) -> KinematicModel {
        let prior = |(parameter, std): (usize, &f64)| Prior {
            parameter,
            mean: 0.0,
            std: *std,
            min: f64::NEG_INFINITY,
            max: f64::INFINITY,
        };
        let is_link = |(parameter, _): &(usize, &f64)| self.parameters[*parameter].is_link();
        let all = stds.iter().enumerate().filter(is_link).map(prior).collect();
        let mut priors = Priors::new(self.nominal, self.parameters, all);
        priors.scale_mm = self.noise_mm;
        let scale: Vec<f64> = self.parameters.iter().map(prior_scale).collect();
        let fitting = Fitting {
            parameters: self.parameters,
            scale: &scale,
            priors: Some(&priors),
        };
        let go_on = &mut |_| ControlFlow::Continue(());
        fitting.run(start, self.observations, 0.0, go_on).model
    }

    /// Root of the posterior covariance, R⁻¹ of the QR decomposition of the whitened rows of points and priors.
    fn root(&self, estimate: &KinematicModel, stds: &[f64]) -> Option<DMatrix<f64>> {
        let (n, p) = (3 * self.observations.len(), self.parameters.len());
        let jacobian = weighted_jacobian(
            estimate,
            self.parameters,
            self.observations,
            &Vector3::zeros(),
        );
        let mut rows = (jacobian / self.noise_mm).resize_vertically(n + p, 0.0);
        for (k, std) in stds.iter().enumerate() {
            rows[(n + k, k)] = 1.0 / std;
        }
        triangularise(rows.as_mut_slice(), n + p, &mut vec![0.0; n + p]);
        let mut root = DMatrix::identity(p, p);
        rows.rows(0, p)
            .solve_upper_triangular_mut(&mut root)
            .then_some(root)
    }
}
