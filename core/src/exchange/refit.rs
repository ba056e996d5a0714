//! Links for simpler controllers: without beta, or with mastering offsets alone.

use crate::compensation::Base;
use crate::compensation::anchor::{anchor_in, contains_tool};
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::least_squares;
use crate::identification::least_squares::problem::Problem;
use crate::identification::model::objective::{Observation, residuals};
use crate::identification::model::parameters::{Parameter, Quantity, paper_parameters};
use crate::identification::statistics::workspace::random_configurations;
use crate::kinematics::{Link, Robot, t_base_flange};
use nalgebra::{IsometryMatrix3, Point3, Vector3};

/// Number of configurations that represent the workspace.
const N_CONFIGURATIONS: usize = 256;
/// Seeds of the fitted configurations, and of others at which the remaining error is measured.
const SEEDS: (u64, u64) = (0, 1);
/// The flange's pose is fitted by three points on its axes at this distance, mm: about the distance of tools.
const TOOL_MM: f64 = 100.0;

/// Links that a controller can store, and the tool's error with them.
#[derive(Clone, Debug, PartialEq)]
pub struct Refit {
    /// The links.
    pub links: Vec<Link>,
    /// Mean distance over the workspace between three points 100 mm from the flange's origin and their positions with the identified links, mm.
    pub mean_mm: f64,
    /// Largest of these distances, mm.
    pub max_mm: f64,
}

/// The links with beta 0 that best fit the identified ones over the workspace. a, alpha, d and theta_offset may change. Combinations of
/// them that the workspace does not determine keep their values.
pub fn without_beta(robot: &Robot, identified: &[Link]) -> Refit {
    let start = identified
        .iter()
        .map(|link| Link {
            beta_rad: 0.0,
            ..*link
        })
        .collect();
    let truth = |q: &[f64]| t_base_flange(identified, q);
    refit(robot, start, &paper_parameters(identified.len()), &truth)
}

/// The nominal links with the joint offsets that best fit the identified robot over the workspace, in the frame of `base`. The offset of
/// the last joint stays nominal, because the tool contains it. In the robot's own base frame, the offset of the first joint stays nominal
/// too, because the base contains it.
pub fn mastering(robot: &Robot, identified: &KinematicModel, base: Base) -> Refit {
    let has_tool = contains_tool(&identified.links, &robot.links);
    let anchor = anchor_in(base, identified, &robot.links, has_tool);
    let truth = |q: &[f64]| anchor.anchored(&t_base_flange(&identified.links, q));
    let last = robot.links.len().saturating_sub(1);
    let parameters: Vec<Parameter> = (0..last)
        .filter(|link| is_mastered(*link, last + 1, base))
        .map(|link| Parameter::Link(link, Quantity::ThetaOffset))
        .collect();
    refit(robot, robot.links.clone(), &parameters, &truth)
}

/// True if [`mastering`] determines the offset of this joint, counted from 0, of a robot with `n_links` joints.
pub fn is_mastered(joint: usize, n_links: usize, base: Base) -> bool {
    let is_known_from = match base {
        Base::Measured => 0,
        Base::Robot => 1,
    };
    joint >= is_known_from && joint + 1 < n_links
}

fn refit(
    robot: &Robot,
    start: Vec<Link>,
    parameters: &[Parameter],
    truth: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
) -> Refit {
    let targets_mm: Vec<Vector3<f64>> = (0..3).map(|axis| Vector3::ith(axis, TOOL_MM)).collect();
    let start = KinematicModel {
        t_instrument_base: IsometryMatrix3::identity(),
        links: start,
        targets_mm,
        target_rotations: vec![],
    };
    let fitted = observations(robot, &start.targets_mm, truth, SEEDS.0);
    let model = if parameters.is_empty() {
        start
    } else {
        least_squares(&Problem::new(start.clone(), parameters, &fitted), &start)
    };
    let others = observations(robot, &model.targets_mm, truth, SEEDS.1);
    let missed: Vec<f64> = residuals(&model, &others)
        .iter()
        .map(Vector3::norm)
        .collect();
    let mean_mm = missed.iter().sum::<f64>() / missed.len() as f64;
    Refit {
        links: model.links,
        mean_mm,
        max_mm: missed.iter().fold(0.0, |m, e| m.max(*e)),
    }
}

fn observations(
    robot: &Robot,
    targets_mm: &[Vector3<f64>],
    truth: &dyn Fn(&[f64]) -> IsometryMatrix3<f64>,
    seed: u64,
) -> Vec<Observation> {
    let at = |q_controller: Vec<f64>| {
        let q_rad = robot.q_model_rad(&q_controller);
        let flange = truth(&q_rad);
        let point = move |(target, p): (usize, &Vector3<f64>)| {
            Observation::at(q_rad.clone(), (flange * Point3::from(*p)).coords, target)
        };
        targets_mm.iter().enumerate().map(point).collect::<Vec<_>>()
    };
    random_configurations(robot, N_CONFIGURATIONS, seed)
        .into_iter()
        .flat_map(at)
        .collect()
}
