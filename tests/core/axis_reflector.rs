//! One reflector on the axis of the last joint: positions do not see how that joint and the flange are turned. The table is in
//! `docs/identification.md`.

use crate::robots::models;
use crate::simulation::{Campaign, Normal, found, measure, poses, true_robot};
use kincal::calibration::{CalibrationRequest, calibrate};
use kincal::identification::KinematicModel;
use kincal::identification::least_squares::start::fit_base_and_targets;
use kincal::identification::model::objective::Observation;
use kincal::identification::model::parameters::{
    Parameter, Quantity, complete_parameters, deviation_from,
};
use kincal::kinematics::reach_mm;
use nalgebra::{Rotation3, Vector3};
use std::ops::ControlFlow;

/// A link number may be off by this many of its prior widths.
const WIDTHS: f64 = 3.0;

/// Width of a link number's prior, mm or rad.
fn width(parameter: &Parameter, reach_mm: f64) -> f64 {
    match parameter {
        Parameter::Link(_, Quantity::A | Quantity::D) => 0.5 * reach_mm / 1700.0,
        Parameter::Link(_, Quantity::ThetaOffset) => 0.3f64.to_radians(),
        _ => 0.05f64.to_radians(),
    }
}

/// Root mean square angle between the flanges of two robots, °.
fn turned_deg(a: &KinematicModel, b: &KinematicModel, q_rad: &[Vec<f64>]) -> f64 {
    let flange = |model: &KinematicModel, q: &[f64]| -> Rotation3<f64> {
        (model.t_instrument_base * kincal::kinematics::t_base_flange(&model.links, q)).rotation
    };
    let squares = q_rad
        .iter()
        .map(|q| flange(a, q).angle_to(&flange(b, q)).powi(2));
    (squares.sum::<f64>() / q_rad.len() as f64)
        .sqrt()
        .to_degrees()
}

#[test]
fn no_link_number_leaves_its_prior_and_the_tool_is_turned_less_than_by_the_nominal_robot() {
    println!(
        "| robot | largest deviation, prior widths | number | tool turned, nominal | tool turned, identified |\n|---|---|---|---|---|"
    );
    for (k, (name, robot)) in models().into_iter().take(4).enumerate() {
        for seed in 0..3 {
            let mut random = Normal::new(4000 + 10 * k as u64 + seed);
            let mut truth = true_robot(&robot, 1, &mut random);
            truth.targets_mm[0] = Vector3::new(0.0, 0.0, 100.0);
            let set = measure(
                &truth,
                &poses(60, &mut random),
                &Campaign::PLAIN,
                &mut random,
            );
            let points: Vec<Observation> = set
                .points
                .iter()
                .map(|p| Observation::at(p.q_rad.clone(), p.position_mm, 0))
                .collect();
            let nominal = fit_base_and_targets(&robot.links, &points, 1);
            let request = CalibrationRequest::new(robot.clone(), set);
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let found = found(&report);
            let links = complete_parameters(robot.links.len(), 1)
                .into_iter()
                .filter(Parameter::is_link);
            let off = |p: &Parameter| {
                deviation_from(&truth, &found, p).abs() / width(p, reach_mm(&robot.links))
            };
            let worst = links.max_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
            let unseen = poses(200, &mut random);
            let [by_nominal, by_found] = [&nominal, &found].map(|m| turned_deg(m, &truth, &unseen));
            println!(
                "| {name} {seed} | {:.2} | {} | {by_nominal:.4}° | {by_found:.4}° |",
                off(&worst),
                worst.name()
            );
            assert!(
                off(&worst) <= WIDTHS && by_found <= by_nominal,
                "{name} {seed}"
            );
        }
    }
}
