//! Noise that differs from direction to direction: rows whitened by the covariance of each point, from the problem to the report.

use crate::central_differences::assert_derivatives;
use crate::data::paper_robot;
use crate::simulation::{
    Campaign, Normal, found, limited, links_alone, measure, poses, robot_of_the_priors,
    tool_intervals_held, true_robot,
};
use crate::trackers::{Instrument, Measured, measured, points_of};
use kincal::calibration::request::{CorrectionsChoice, Loss};
use kincal::calibration::{CalibrationReport, CalibrationRequest, Preset, calibrate, verify};
use kincal::identification::KinematicModel;
use kincal::identification::corrections::corrected::IdentifiedRobot;
use kincal::identification::least_squares::linearisation::scaled_jacobian_at;
use kincal::identification::least_squares::problem::Problem;
use kincal::identification::model::objective::{
    Observation, cost, weighted_jacobian, weighted_residuals,
};
use kincal::identification::model::parameters::complete_parameters;
use kincal::kinematics::Robot;
use kincal::measurement::position_noise::PositionNoise;
use kincal::measurement::{MeasurementSet, Point};
use nalgebra::{DMatrix, IsometryMatrix3, Rotation3, Translation3, Vector3};
use std::collections::BTreeMap;
use std::ops::ControlFlow;

/// scipy's weighted least squares of the same points, by `docs/oracles/scipy_noise.py`.
const SCIPY: &str = include_str!("../../docs/oracles/scipy_noise.csv");
/// Robots of a test.
const ROBOTS: u64 = 12;

fn nominal() -> Robot {
    limited(paper_robot())
}

fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn identified(set: MeasurementSet) -> CalibrationReport {
    run(&links_alone(&CalibrationRequest::new(nominal(), set)))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn observations(set: &MeasurementSet) -> Vec<Observation> {
    let nominal = nominal();
    let observation = |p: &Point| Observation {
        q_rad: nominal.q_model_rad(&p.q_rad),
        position_mm: p.position_mm,
        target: p.target,
        weight: 0.7,
        whitening: p.position_noise.map(|noise| noise.whitening(0.02)),
        rotation: None,
        station: None,
    };
    set.points.iter().map(observation).collect()
}

#[test]
fn derivatives_of_whitened_rows_are_those_of_central_differences() {
    let Measured { truth, set, .. } = measured(&nominal(), Instrument::Tracker, 0.0, 1);
    let points = observations(&set);
    let parameters = complete_parameters(6, 1);
    let problem = Problem::new(truth, &parameters, &points);
    let mut random = Normal::new(2);
    let x: Vec<f64> = parameters.iter().map(|_| 0.1 * random.draw()).collect();
    assert_derivatives(&problem, &parameters, &x);
}

/// Rounding of sums over some hundred rows.
const ROUNDING: f64 = 1e-9;

#[test]
fn the_cost_is_the_squared_mahalanobis_length_of_every_residual() {
    let Measured { truth, set, .. } = measured(&nominal(), Instrument::Tracker, 0.0, 3);
    let points = observations(&set);
    // naively: eᵀ·C⁻¹·e, times the mean of the variances that a row of weight 1 has
    let mut naive = 0.0;
    for (o, point) in points.iter().zip(&set.points) {
        let noise = point.position_noise.unwrap();
        let mut covariance = nalgebra::Matrix3::zeros();
        for axis in 0..3 {
            let u: Vector3<f64> = noise.axes.column(axis).into();
            covariance += u * u.transpose() * (noise.std_mm[axis].powi(2) + 0.02f64.powi(2));
        }
        let e = o.position_mm - truth.position(&o.q_rad, 0);
        let mean_mm2 = covariance.trace() / 3.0;
        naive += 0.7 * mean_mm2 * e.dot(&(covariance.try_inverse().unwrap() * e));
    }
    let found = cost(&truth, &points);
    assert!((found / naive - 1.0).abs() < ROUNDING, "{found} {naive}");
    let rows = weighted_residuals(&truth, &points);
    assert!((rows.norm_squared() / naive - 1.0).abs() < ROUNDING);
    // both Jacobians have the same rows
    let parameters = complete_parameters(6, 1);
    let at_reference = Vector3::zeros();
    let plain = weighted_jacobian(&truth, &parameters, &points, &at_reference);
    let problem = Problem::new(truth, &parameters, &points);
    let mut scaled = DMatrix::zeros(problem.n_rows(), parameters.len());
    let x = vec![0.0; parameters.len()];
    problem.evaluate(&x, &mut vec![0.0; problem.n_rows()], Some(&mut scaled));
    for (j, variable) in problem.variables.iter().enumerate() {
        let off = scaled.column(j) + plain.column(j) * variable.width;
        let size = scaled.column(j).norm();
        assert!(off.norm() <= ROUNDING * size, "{:?}", parameters[j]);
    }
}

#[test]
fn the_rank_is_that_of_the_whitened_rows() {
    let Measured { truth, set, .. } = measured(&nominal(), Instrument::Tracker, 0.0, 3);
    let points = observations(&set);
    let parameters = complete_parameters(6, 1);
    let ones = vec![1.0; parameters.len()];
    let scaled = scaled_jacobian_at(&truth, &parameters, &ones, &points);
    let plain = weighted_jacobian(&truth, &parameters, &points, &Vector3::zeros());
    let expected = plain / (points.len() as f64).sqrt();
    assert!((scaled - &expected).norm() < ROUNDING * expected.norm());
}

/// What a stated noise has to gain at least: without it the error is as many times larger.
const GAIN: f64 = 1.3;
/// Of scipy's error, which knows the covariances.
const NEAR_SCIPY: f64 = 1.02;

#[test]
fn a_stated_noise_by_direction_gains_what_weighted_least_squares_of_scipy_gains() {
    let scipy: BTreeMap<&str, f64> = SCIPY
        .lines()
        .skip(1)
        .map(|line| {
            let mut cells = line.split(',');
            (
                cells.next().unwrap(),
                cells.next().unwrap().parse().unwrap(),
            )
        })
        .collect();
    for instrument in Instrument::ALL {
        let (mut gains, mut over_scipy) = (vec![], vec![]);
        for seed in 0..ROBOTS {
            let measured = measured(&nominal(), instrument, 0.0, seed);
            let error = |set| measured.error_mm(&found(&identified(set)));
            let (without, stated) = (error(measured.unstated()), error(measured.set.clone()));
            let name = format!("{}_0_{seed}", instrument.name());
            gains.push(without / stated);
            over_scipy.push(stated / scipy[name.as_str()]);
        }
        let (gain, over) = (median(gains), median(over_scipy));
        println!("{instrument:?}: {gain:.3} times lower, {over:.3} of scipy's");
        assert!(gain >= GAIN, "{instrument:?}: {gain}");
        assert!(over <= NEAR_SCIPY, "{instrument:?}: {over}");
    }
}

#[test]
fn with_noise_by_direction_the_stated_intervals_of_the_tool_hold_it_in_93_to_97_of_100_cases() {
    for instrument in Instrument::ALL {
        let (mut stated, mut held) = (0, 0);
        for seed in 0..40 {
            let measured = measured(&nominal(), instrument, 0.0, 100 + seed);
            let report = identified(measured.set);
            let elsewhere = poses(20, &mut Normal::new(1000 + seed));
            let counts = tool_intervals_held(&nominal(), &measured.truth, &report, &elsewhere, 0.0);
            (stated, held) = (stated + counts.0, held + counts.1);
        }
        let share = 100.0 * held as f64 / stated as f64;
        println!("{instrument:?}: {share:.2} % of {stated}");
        // 40 robots at 95 %, whose intervals err together: three standard deviations are 2 %
        assert!((93.0..=97.5).contains(&share), "{instrument:?}: {share} %");
    }
}

/// A stated noise may cost so much where it is far too small: the part beside it is estimated.
const COSTS: f64 = 1.03;

#[test]
fn a_noise_that_is_stated_far_too_small_costs_nothing() {
    let mut ratios = vec![];
    for seed in 0..ROBOTS {
        // the robot scatters by 0.1 mm in all directions; the instrument states a hundredth and a tenth of that
        let mut measured = measured(&nominal(), Instrument::Tracker, 0.1, seed);
        for point in &mut measured.set.points {
            let noise = point.position_noise.as_mut().unwrap();
            noise.std_mm = Vector3::new(0.001, 0.01, 0.01);
        }
        let error = |set| measured.error_mm(&found(&identified(set)));
        ratios.push(error(measured.set.clone()) / error(measured.unstated()));
    }
    let ratio = median(ratios);
    println!("{ratio:.3} times the error without it");
    assert!(ratio <= COSTS, "{ratio}");
}

#[test]
fn noise_that_is_alike_along_all_axes_counts_as_one_number_does() {
    let Measured { set, .. } = measured(&nominal(), Instrument::Tracker, 0.0, 7);
    let (mut by_axis, mut one_number) = (set.clone(), set);
    for (row, point) in by_axis.points.iter_mut().enumerate() {
        let std_mm = 0.05 + 0.001 * row as f64;
        point.position_noise = Some(PositionNoise::of_axes(Vector3::repeat(std_mm)));
        one_number.points[row].position_noise = None;
        one_number.points[row].std_mm = Some(std_mm);
    }
    let (a, b) = (identified(by_axis), identified(one_number));
    // a root mean square of three equal numbers is that number but for its last digit
    let off = (a.cost_mm2 / b.cost_mm2 - 1.0).abs();
    assert!(off < ROUNDING, "{off}");
}

#[test]
fn the_papers_preset_weighs_a_point_by_the_root_mean_square_of_its_directions() {
    let Measured { set, .. } = measured(&nominal(), Instrument::Camera, 0.0, 8);
    let mut rms = set.clone();
    for point in &mut rms.points {
        point.std_mm = point.position_std_mm();
        point.position_noise = None;
    }
    let paper = |mut set: MeasurementSet| {
        set.frame = kincal::measurement::Frame::Instrument;
        let mut request = CalibrationRequest::new(nominal(), set);
        request.preset = Preset::Paper;
        request.model = Some(kincal::calibration::Model::Complete);
        request.method = kincal::calibration::Method::LeastSquares;
        run(&request)
    };
    let (by_direction, scalar) = (paper(set), paper(rms));
    assert_eq!(by_direction.links, scalar.links, "bit for bit");
    assert_eq!(by_direction.convergence_mm2, scalar.convergence_mm2);
}

#[test]
fn a_known_robot_is_placed_by_the_better_direction() {
    let nominal = nominal();
    let mut gains = vec![];
    for seed in 0..ROBOTS {
        let mut random = Normal::new(300 + seed);
        let mut truth = robot_of_the_priors(&nominal, 1, &mut random);
        truth.t_instrument_base.translation.vector = Vector3::new(4000.0, 500.0, 200.0);
        let set = points_of(
            &truth,
            Instrument::Tracker,
            0.0,
            &poses(15, &mut random),
            &mut random,
        );
        let measured = Measured {
            unseen: poses(200, &mut random),
            truth: truth.clone(),
            set,
        };
        let placed = |set: MeasurementSet| -> KinematicModel {
            let robot = IdentifiedRobot {
                plain: truth.clone(),
                corrected: None,
            };
            let request = CalibrationRequest::new(nominal.clone(), set);
            let report = verify(&request, Some(&robot), &mut |_| ControlFlow::Continue(()));
            found(&report.unwrap())
        };
        let error = |set| measured.error_mm(&placed(set));
        gains.push(error(measured.unstated()) / error(measured.set.clone()));
    }
    let gain = median(gains);
    println!("placed {gain:.3} times nearer");
    assert!(gain >= GAIN, "{gain}");
}

#[test]
fn the_noise_of_every_station_is_that_of_its_own_beam() {
    let nominal = nominal();
    let mut gains = vec![];
    for seed in 0..ROBOTS {
        let measured = measured(&nominal, Instrument::Tracker, 0.0, 400 + seed);
        let mut random = Normal::new(500 + seed);
        // the tracker stands a quarter turn further round the robot for the second half of the points, and measures in its own frame
        let turn = Rotation3::from_euler_angles(0.1, 0.2, 1.6);
        let shift = Translation3::new(3000.0, -3500.0, 300.0);
        let second = IsometryMatrix3::from_parts(shift, turn);
        let mut there = measured.truth.clone();
        there.t_instrument_base = second;
        let q: Vec<Vec<f64>> = measured.set.points[25..]
            .iter()
            .map(|p| p.q_rad.clone())
            .collect();
        let others = points_of(&there, Instrument::Tracker, 0.0, &q, &mut random);
        let mut set = measured.set.clone();
        for (row, other) in (25..50).zip(others.points) {
            set.points[row].position_mm = other.position_mm;
            set.points[row].position_noise = other.position_noise;
        }
        for (row, point) in set.points.iter_mut().enumerate() {
            point.station = Some(if row < 25 { "front" } else { "side" }.into());
        }
        let unstated = Measured {
            set: set.clone(),
            truth: there.clone(),
            unseen: vec![],
        }
        .unstated();
        // all rests on the last station
        let measured = Measured {
            truth: there,
            ..measured
        };
        let error = |set| measured.error_mm(&found(&identified(set)));
        gains.push(error(unstated) / error(set));
    }
    let gain = median(gains);
    println!("two stations: {gain:.3} times lower");
    assert!(gain >= GAIN, "{gain}");
}

#[test]
fn gross_errors_beside_noise_by_direction_are_weighed_down_by_a_robust_loss() {
    let mut ratios = vec![];
    for seed in 0..ROBOTS {
        let measured = measured(&nominal(), Instrument::Tracker, 0.0, 600 + seed);
        let mut random = Normal::new(700 + seed);
        let mut with_gross = measured.set.clone();
        for row in [11, 37] {
            with_gross.points[row].position_mm += random.vector().normalize() * 5.0;
        }
        let robust = |set: MeasurementSet| {
            let mut request = CalibrationRequest::new(nominal(), set);
            request.options.loss = Some(Loss::Huber);
            measured.error_mm(&found(&run(&links_alone(&request))))
        };
        ratios.push(robust(with_gross) / robust(measured.set.clone()));
    }
    let ratio = median(ratios);
    println!("{ratio:.3} times the error without gross errors");
    // two of fifty points less, and Huber's bounded pull of two
    assert!(ratio <= 1.2, "{ratio}");
}

/// A tracker of 3 mm on an arm of 2 m: half of the points are farther away than `no_fit` allows without stated noise.
#[test]
fn coarse_points_whose_noise_is_stated_fit() {
    let mut random = Normal::new(31);
    let truth = robot_of_the_priors(&nominal(), 1, &mut random);
    let campaign = Campaign {
        noise_mm: 3.0,
        ..Campaign::PLAIN
    };
    let set = measure(&truth, &poses(80, &mut random), &campaign, &mut random);
    let mut stated = set.clone();
    for point in &mut stated.points {
        point.std_mm = Some(3.0);
    }
    for (set, is_stated) in [(set, false), (stated, true)] {
        let report = identified(set);
        let is_fit = report.warnings.iter().all(|told| told.code != "no_fit");
        println!("stated {is_stated}: {}", report.method_reason);
        assert_eq!(is_fit, is_stated, "{:?}", report.warnings);
    }
}

/// A file of whole millimetres says nothing about tenths, however well a few of its points are fitted.
#[test]
fn the_noise_is_not_below_the_rounding_of_the_file() {
    let robot = paper_robot();
    let (mut least, mut sum_mm2) = (f64::INFINITY, 0.0);
    for seed in 0..12 {
        let mut random = Normal::new(5200 + seed);
        let truth = true_robot(&robot, 1, &mut random);
        let q_rad = poses(12, &mut random);
        let mut set = measure(&truth, &q_rad, &Campaign::PLAIN, &mut random);
        set.points
            .iter_mut()
            .for_each(|p| p.position_mm = p.position_mm.map(f64::round));
        let request = CalibrationRequest {
            corrections: Some(CorrectionsChoice::Off),
            ..CalibrationRequest::new(robot.clone(), set)
        };
        let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
        let stated = report
            .estimate
            .as_ref()
            .map(|estimate| estimate.noise.std_mm);
        least = stated.unwrap_or(f64::INFINITY).min(least);
        let model = found(&report);
        let unseen = poses(100, &mut random);
        let squares = unseen
            .iter()
            .map(|q| (model.position(q, 0) - truth.position(q, 0)).norm_squared());
        sum_mm2 += squares.sum::<f64>() / 1200.0;
    }
    println!("least noise {least:.4} mm, unseen {:.4} mm", sum_mm2.sqrt());
    assert!(least >= 1.0 / 12f64.sqrt());
}
