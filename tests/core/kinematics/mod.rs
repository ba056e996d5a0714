//! Forward kinematics, its Jacobian and the vectorised kernel, each compared with a second implementation.

mod compliance;
mod kernel;
mod lower_bound;
mod one_robot;

use crate::data::{paper_robot, paper_set};
use kincal::identification::KinematicModel;
use kincal::identification::model::objective;
use kincal::identification::model::parameters::{Parameter, Quantity, apply, complete_parameters};
use kincal::kinematics::{Link, forward_kinematics, t_base_flange};
use kincal::measurement::Subset;
use nalgebra::{IsometryMatrix3, Matrix4, Rotation3, Translation3, Vector3, Vector4};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::f64::consts::{PI, TAU};

/// Rounding difference between two ways to multiply six to twelve 4×4 matrices with entries of some metres, mm.
const ROUNDING_MM: f64 = 1e-9;
/// Error of central differences with steps of 1e-5 rad or 1e-3 mm on lever arms of metres, truncation and rounding, mm/rad.
const DIFFERENCE: f64 = 2e-4;

fn random_links(random: &mut ChaCha8Rng, n: usize) -> Vec<Link> {
    (0..n)
        .map(|_| Link {
            a_mm: random.random_range(-800.0..800.0),
            alpha_rad: random.random_range(-PI..PI),
            d_mm: random.random_range(-800.0..800.0),
            theta_offset_rad: random.random_range(-PI..PI),
            beta_rad: if random.random::<bool>() {
                random.random_range(-0.5..0.5)
            } else {
                0.0
            },
        })
        .collect()
}

fn random_q(random: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    (0..n).map(|_| random.random_range(-PI..PI)).collect()
}

fn random_model(random: &mut ChaCha8Rng, n_links: usize, n_targets: usize) -> KinematicModel {
    let axis = Vector3::new(
        random.random_range(-1.0..1.0),
        random.random_range(-1.0..1.0),
        random.random_range(-1.0..1.0),
    );
    let rotation = Rotation3::from_axis_angle(
        &nalgebra::Unit::new_normalize(axis),
        random.random_range(-3.0..3.0),
    );
    let mut vector = |size: f64| {
        Vector3::new(
            random.random_range(-size..size),
            random.random_range(-size..size),
            random.random_range(-size..size),
        )
    };
    KinematicModel {
        t_instrument_base: IsometryMatrix3::from_parts(
            Translation3::from(vector(3000.0)),
            rotation,
        ),
        targets_mm: (0..n_targets).map(|_| vector(200.0)).collect(),
        links: random_links(random, n_links),
        target_rotations: vec![],
    }
}

/// The matrix of [Gao 2018, eq. 3] as printed, element by element, multiplied as plain 4×4 matrices.
fn printed_link(link: &Link, q_rad: f64) -> Matrix4<f64> {
    let (st, ct) = (q_rad + link.theta_offset_rad).sin_cos();
    let (sa, ca) = link.alpha_rad.sin_cos();
    Matrix4::new(
        ct,
        -st,
        0.0,
        link.a_mm,
        st * ca,
        ct * ca,
        -sa,
        -link.d_mm * sa,
        st * sa,
        ct * sa,
        ca,
        link.d_mm * ca,
        0.0,
        0.0,
        0.0,
        1.0,
    )
}

#[test]
fn forward_kinematics_equals_the_printed_matrices() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for n_links in 1..=12 {
        let mut links = random_links(&mut random, n_links);
        links.iter_mut().for_each(|link| link.beta_rad = 0.0);
        let q = random_q(&mut random, n_links);
        let target = Vector3::new(10.0, -20.0, 30.0);
        let product = links
            .iter()
            .zip(&q)
            .fold(Matrix4::identity(), |t, (link, q)| {
                t * printed_link(link, *q)
            });
        let printed = (product * Vector4::new(target.x, target.y, target.z, 1.0)).xyz();
        assert!((printed - forward_kinematics(&links, &q, &target)).norm() < ROUNDING_MM);
    }
}

#[test]
fn a_link_with_beta_is_rx_dx_ry_rz_dz() {
    let link = Link {
        a_mm: 120.0,
        alpha_rad: 0.3,
        d_mm: -40.0,
        theta_offset_rad: 0.2,
        beta_rad: 0.01,
    };
    let rotate = |axis: Vector3<f64>, angle: f64| {
        Rotation3::from_axis_angle(&nalgebra::Unit::new_normalize(axis), angle).to_homogeneous()
    };
    let shift = |x: f64, z: f64| Translation3::new(x, 0.0, z).to_homogeneous();
    let expected = rotate(Vector3::x(), 0.3)
        * shift(120.0, 0.0)
        * rotate(Vector3::y(), 0.01)
        * rotate(Vector3::z(), 0.7 + 0.2)
        * shift(0.0, -40.0);
    assert!((expected - t_base_flange(&[link], &[0.7]).to_homogeneous()).norm() < ROUNDING_MM);
}

#[test]
fn the_nominal_robot_misses_the_papers_points_by_what_paper_md_states() {
    let (robot, set) = (paper_robot(), paper_set("first.csv"));
    let error = |p: &kincal::measurement::Point| {
        (p.position_mm - forward_kinematics(&robot.links, &p.q_rad, &Vector3::zeros())).norm()
    };
    let errors: Vec<f64> = set.points.iter().map(error).collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let cost: f64 = set
        .points
        .iter()
        .filter(|p| p.subset == Some(Subset::Identify))
        .map(|p| error(p).powi(2))
        .sum();
    // To the stated digits.
    assert!((mean - 1.0478669).abs() < 5e-8, "mean {mean}");
    assert!((errors.iter().fold(0.0f64, |m, e| m.max(*e)) - 1.581740).abs() < 5e-7);
    assert!((cost - 64.853).abs() < 5e-4, "F {cost}");
}

#[test]
fn a_full_turn_of_any_joint_changes_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let links = random_links(&mut random, 6);
    let q = random_q(&mut random, 6);
    let there = forward_kinematics(&links, &q, &Vector3::zeros());
    for joint in 0..6 {
        let mut turned = q.clone();
        turned[joint] += TAU;
        assert!(
            (there - forward_kinematics(&links, &turned, &Vector3::zeros())).norm() < ROUNDING_MM
        );
    }
}

#[test]
fn every_column_of_the_jacobian_equals_central_differences() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for n_links in 1..=12 {
        let reference = random_model(&mut random, n_links, 2);
        let quantities = [
            Quantity::A,
            Quantity::Alpha,
            Quantity::D,
            Quantity::ThetaOffset,
            Quantity::Beta,
        ];
        let mut parameters: Vec<Parameter> = (0..n_links)
            .flat_map(|l| quantities.map(|q| Parameter::Link(l, q)))
            .collect();
        parameters.extend((0..3).map(Parameter::BaseTranslation));
        parameters.extend((0..3).map(Parameter::BaseRotation));
        parameters.extend((0..3).map(|axis| Parameter::Target(1, axis)));
        // Away from the reference, so that the base's rotation vector is not zero.
        let at: Vec<f64> = parameters
            .iter()
            .map(|p| random.random_range(-1.0..1.0) * if p.is_angle() { 0.3 } else { 5.0 })
            .collect();
        let observation = objective::Observation {
            q_rad: random_q(&mut random, n_links),
            position_mm: Vector3::zeros(),
            target: 1,
            weight: 2.25,
            whitening: None,
            rotation: None,
            station: None,
        };
        let turned = Vector3::new(
            at[5 * n_links + 3],
            at[5 * n_links + 4],
            at[5 * n_links + 5],
        );
        let model = apply(&reference, &parameters, &at);
        let jacobian = objective::weighted_jacobian(
            &model,
            &parameters,
            std::slice::from_ref(&observation),
            &turned,
        );
        for (column, parameter) in parameters.iter().enumerate() {
            let step = if parameter.is_angle() { 1e-5 } else { 1e-3 };
            let predicted = |sign: f64| {
                let mut moved = at.clone();
                moved[column] += sign * step;
                // residual = measured − predicted, so the prediction is its negative here.
                -objective::weighted_residuals(
                    &apply(&reference, &parameters, &moved),
                    std::slice::from_ref(&observation),
                )
            };
            let difference = (predicted(1.0) - predicted(-1.0)) / (2.0 * step);
            assert!(
                (difference - jacobian.column(column)).norm() < DIFFERENCE,
                "{} with {n_links} links",
                parameter.name()
            );
        }
    }
}

#[test]
fn the_complete_model_has_all_five_numbers_of_every_link() {
    let names: Vec<String> = complete_parameters(2, 1)
        .iter()
        .map(Parameter::name)
        .collect();
    let expected = "base_x base_y base_z base_rx base_ry base_rz a_1 alpha_1 d_1 theta_offset_1 beta_1 a_2 alpha_2 d_2 \
                    theta_offset_2 beta_2 target_0_x target_0_y target_0_z";
    assert_eq!(names.join(" "), expected);
    assert_eq!(complete_parameters(6, 1).len(), 39);
    assert_eq!(complete_parameters(6, 3).len(), 45);
}
