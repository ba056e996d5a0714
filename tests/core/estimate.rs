//! The most probable robot: its rows, its noise and widths, and robots of odd kinds whose truth is planted.

use crate::central_differences::assert_derivatives;
use crate::data::paper_robot;
use crate::simulation::Normal;
use kincal::identification::KinematicModel;
use kincal::identification::least_squares::estimate::{Estimate, estimate};
use kincal::identification::least_squares::problem::{KINDS, Prior, Problem};
use kincal::identification::least_squares::start::{fit_base_and_targets, place};
use kincal::identification::model::objective::{Observation, cost};
use kincal::identification::model::parameters::complete_parameters;
use kincal::kinematics::compliance::t_base_flange_corrected;
use kincal::kinematics::{Corrections, Link, Mounting};
use nalgebra::{DMatrix, DVector, IsometryMatrix3, Point3, Rotation3, Translation3, Unit, Vector3};
use rand::RngExt;
use std::ops::ControlFlow;

/// A robot that is built and measured.
#[derive(Clone)]
struct Making {
    links: Vec<Link>,
    length_mm: f64,
    angle_deg: f64,
    /// Joint offsets are off by up to this.
    offset_deg: f64,
    target_mm: Vector3<f64>,
    noise_mm: f64,
}

/// The paper's robot at some scale, as a good workshop builds it.
fn er20(scale: f64) -> Making {
    let links = paper_robot().links.into_iter().map(|link| Link {
        a_mm: link.a_mm * scale,
        d_mm: link.d_mm * scale,
        ..link
    });
    Making {
        links: links.collect(),
        length_mm: 0.3 * scale,
        angle_deg: 0.05,
        offset_deg: 0.0,
        target_mm: Vector3::new(60.0, -40.0, 100.0) * scale,
        noise_mm: 0.03 * scale,
    }
}

impl Making {
    /// The true robot, somewhere in the room: every number of its links is off.
    fn truth(&self, random: &mut Normal) -> KinematicModel {
        let mut links = self.links.clone();
        for (i, link) in links.iter_mut().enumerate() {
            link.a_mm += self.length_mm * random.draw();
            link.d_mm += self.length_mm * random.draw();
            let mut angle = || (self.angle_deg * random.draw()).to_radians();
            link.alpha_rad += angle();
            link.theta_offset_rad += angle();
            link.beta_rad += if i > 0 { angle() } else { 0.0 };
            let offset_deg = self.offset_deg * (2.0 * random.0.random::<f64>() - 1.0);
            link.theta_offset_rad += offset_deg.to_radians();
        }
        let axis = Unit::new_normalize(random.vector());
        let turn = Rotation3::from_axis_angle(&axis, random.0.random_range(0.0..2.5));
        let reach_mm: f64 = links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
        let at = Translation3::from(random.vector() * reach_mm);
        KinematicModel {
            t_instrument_base: IsometryMatrix3::from_parts(at, turn),
            links,
            targets_mm: vec![self.target_mm],
            target_rotations: vec![],
        }
    }

    fn measured(&self, truth: &KinematicModel, n: usize, random: &mut Normal) -> Vec<Observation> {
        let one = |_| {
            let q_rad: Vec<f64> = (0..self.links.len())
                .map(|_| random.0.random_range(-1.4..1.4))
                .collect();
            Observation {
                position_mm: truth.position(&q_rad, 0) + random.vector() * self.noise_mm,
                q_rad,
                target: 0,
                weight: 1.0,
                whitening: None,
                rotation: None,
                station: None,
            }
        };
        (0..n).map(one).collect()
    }
}

fn most_probable(making: &Making, points: &[Observation]) -> Estimate {
    let nominal = fit_base_and_targets(&making.links, points, 1);
    let parameters = complete_parameters(making.links.len(), 1);
    let problem = Problem::new(nominal, &parameters, points);
    let start = vec![0.0; parameters.len()];
    estimate(&problem, &start, 0.0, &mut |_| ControlFlow::Continue(()))
}

#[test]
fn derivatives_of_the_rows_are_those_of_central_differences() {
    let (making, mut random) = (er20(1.0), Normal::new(1));
    let truth = making.truth(&mut random);
    let mut points = making.measured(&truth, 7, &mut random);
    for (i, point) in points.iter_mut().enumerate() {
        (point.target, point.weight) = (i % 2, 1.0 + i as f64);
    }
    let mut reference = truth.clone();
    reference.targets_mm.push(Vector3::new(-30.0, 80.0, 20.0));
    let parameters = complete_parameters(6, 2);
    let problem = Problem::new(reference, &parameters, &points);
    let x: Vec<f64> = parameters.iter().map(|_| 0.5 * random.draw()).collect();
    assert_eq!((problem.n_rows(), x.len()), (21, 42));
    assert_derivatives(&problem, &parameters, &x);
}

/// Noise and widths are found to a thousandth; the equations hold to a few of them.
const FIXED_POINT: f64 = 5e-3;

#[test]
fn noise_and_widths_fulfil_the_equations_that_define_them() {
    // lengths and angles far larger than the priors at first, so that their widths grow
    let (mut making, mut random) = (er20(1.0), Normal::new(2));
    (making.length_mm, making.angle_deg) = (3.0, 0.3);
    let truth = making.truth(&mut random);
    let points = making.measured(&truth, 40, &mut random);
    let found = most_probable(&making, &points);
    let nominal = fit_base_and_targets(&making.links, &points, 1);
    let parameters = complete_parameters(6, 1);
    let problem = Problem::new(nominal, &parameters, &points);
    let (n, p) = (problem.n_rows(), parameters.len());
    let (mut r, mut jacobian) = (DVector::zeros(n), DMatrix::zeros(n, p));
    problem.evaluate(&found.x, r.as_mut_slice(), Some(&mut jacobian));
    let (sigma_mm, widths) = (found.evidence.sigma_mm, &found.evidence.widths);
    let per_variance = DVector::from_fn(p, |j, _| 1.0 / (widths[j] * widths[j]));
    let s2 = sigma_mm * sigma_mm;
    let normal = jacobian.tr_mul(&jacobian) / s2 + DMatrix::from_diagonal(&per_variance);
    let covariance = normal.clone().try_inverse().unwrap();
    let x = DVector::from_column_slice(&found.x);
    let gradient = jacobian.tr_mul(&r) / s2 + x.component_mul(&per_variance);
    // the step that is left, in standard deviations
    let left = (covariance.clone() * &gradient).dot(&gradient).sqrt();
    assert!(left < 0.01, "{left} standard deviations from the minimum");
    let variance = |j: usize| covariance[(j, j)];
    let n_determined: f64 = (0..p).map(|j| 1.0 - variance(j) * per_variance[j]).sum();
    let expected = (r.norm_squared() / (n as f64 - n_determined)).sqrt();
    assert!((sigma_mm / expected - 1.0).abs() < FIXED_POINT);
    assert!((26.0..27.5).contains(&n_determined), "{n_determined}");
    for (k, kind) in KINDS.into_iter().enumerate() {
        let g = found.evidence.prior_growth[k];
        let of_kind: Vec<usize> = (0..p)
            .filter(|j| problem.variables[*j].prior == Prior::OfKind(kind))
            .collect();
        for j in &of_kind {
            let width2 = (2.0 * g * g + x[*j] * x[*j] + variance(*j)) / 3.0;
            assert!((widths[*j] / width2.sqrt() - 1.0).abs() < FIXED_POINT);
        }
        let share = |j: &usize| 1.0 - variance(*j) * per_variance[*j];
        let determined: f64 = of_kind.iter().map(share).sum();
        let squares: f64 = of_kind
            .iter()
            .map(|j| x[*j] * x[*j] * per_variance[*j] * g * g)
            .sum();
        let expected = (squares / determined).sqrt().max(1.0);
        assert!((g / expected - 1.0).abs() < FIXED_POINT, "{g} {expected}");
    }
    assert!(
        found.evidence.prior_growth[0] > 1.5,
        "{:?}",
        found.evidence.prior_growth
    );
    // the root is one of the covariance
    let root = &found.posterior.root;
    let difference = (root * root.transpose() - &covariance).abs();
    for i in 0..p {
        for j in 0..p {
            let size = (variance(i) * variance(j)).sqrt();
            assert!(difference[(i, j)] < 1e-3 * size);
        }
    }
}

/// 150 equations leave the prediction of 27 combinations a fifth larger than the noise, 40 % at the worst of these robots.
const OVER_NOISE: f64 = 1.4;

#[test]
fn robots_of_odd_kinds_are_predicted_nearly_as_well_as_they_are_measured() {
    let tilted = |deg: f64| {
        let mut making = er20(1.0);
        making.links[2].alpha_rad = deg.to_radians();
        making
    };
    let rough = |scale: f64, times: f64| Making {
        length_mm: 0.3 * scale * times,
        angle_deg: 0.05 * times,
        ..er20(scale)
    };
    let off = |deg: f64| Making {
        offset_deg: deg,
        ..er20(1.0)
    };
    let on_axis = Making {
        target_mm: Vector3::new(0.0, 0.0, 100.0),
        ..er20(1.0)
    };
    for (name, making) in [
        ("as drawn", er20(1.0)),
        ("axes 2 and 3 tilted by 1.2°", tilted(1.2)),
        ("axes 2 and 3 tilted by 2°", tilted(2.0)),
        ("axes 2 and 3 tilted by 5°", tilted(5.0)),
        ("an arm of 10 mm", er20(0.006)),
        ("an arm of 10 mm, coarse", rough(0.006, 10.0)),
        ("an arm of 20 m", rough(12.0, 6.0)),
        ("joints off by 20°", off(20.0)),
        ("errors ten times the prior", rough(1.0, 10.0)),
        ("a target on the last axis", on_axis),
    ] {
        for seed in 0..3 {
            let mut random = Normal::new(seed);
            let truth = making.truth(&mut random);
            let points = making.measured(&truth, 50, &mut random);
            let unseen = making.measured(&truth, 200, &mut random);
            let found = most_probable(&making, &points);
            let rms_mm = (cost(&found.model, &unseen) / unseen.len() as f64).sqrt();
            let ratio = rms_mm / (3.0f64.sqrt() * making.noise_mm);
            println!("{name}, seed {seed}: {ratio:.3} of the noise");
            assert!(ratio < OVER_NOISE, "{name}, seed {seed}: {ratio}");
        }
    }
}

/// What rounding and the end of least squares leave of a placement, mm.
const PLACED_MM: f64 = 1e-6;

#[test]
fn a_robot_that_sags_is_placed_by_least_squares() {
    let (making, mut random) = (er20(1.0), Normal::new(3));
    let mounting = Mounting {
        gravity_in_base: -Vector3::z(),
        std_rad: 0.0,
    };
    let mut corrections = Corrections::none(6, &mounting);
    for joint in [1, 2] {
        corrections.compliance.joints_rad[joint].z = 1e-3;
    }
    let truth = making.truth(&mut random);
    let mut points = making.measured(&truth, 30, &mut random);
    let flange = |o: &Observation| t_base_flange_corrected(&truth.links, &corrections, &o.q_rad);
    let flanges: Vec<IsometryMatrix3<f64>> = points.iter().map(flange).collect();
    let position = |flange: &IsometryMatrix3<f64>, placed: &KinematicModel| {
        let target = Point3::from(placed.targets_mm[0]);
        (placed.t_instrument_base * flange * target).coords
    };
    for (o, flange) in points.iter_mut().zip(&flanges) {
        o.position_mm = position(flange, &truth);
    }
    let found = place(&truth.links, &flanges, &points, 1);
    for flange in &flanges {
        let off_mm = (position(flange, &found) - position(flange, &truth)).norm();
        assert!(off_mm < PLACED_MM, "{off_mm}");
    }
    for o in &mut points {
        o.position_mm += random.vector() * 0.1;
    }
    let found = place(&truth.links, &flanges, &points, 1);
    let cost = |placed: &KinematicModel| -> f64 {
        let square = |(o, flange): (&Observation, _)| {
            (o.position_mm - position(flange, placed)).norm_squared()
        };
        points.iter().zip(&flanges).map(square).sum()
    };
    for axis in 0..3 {
        for step in [1e-3, -1e-3] {
            let step = Vector3::ith(axis, step);
            let (mut shifted, mut turned, mut other) =
                (found.clone(), found.clone(), found.clone());
            shifted.t_instrument_base.translation.vector += step;
            turned.t_instrument_base.rotation *= Rotation3::new(step * 1e-3);
            other.targets_mm[0] += step;
            for moved in [shifted, turned, other] {
                assert!(cost(&moved) > cost(&found));
            }
        }
    }
}
