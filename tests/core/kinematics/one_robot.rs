//! Residuals and derivatives for least squares: equal to the readable implementation, and the same bits on every code path.

use super::{random_model, random_q};
use kincal::identification::least_squares::linearisation::Linearisation;
use kincal::identification::model::objective::{
    Observation, weighted_jacobian, weighted_residuals,
};
use kincal::identification::model::parameters::{Parameter, Quantity};
use kincal::identification::model::search_space::SearchSpace;
use kincal::kinematics::batch::InstructionSet;
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Tolerance, mm: some roundings of ten metres. Derivatives by angles are as large as lengths.
const ROUNDING_MM: f64 = 1e-10;
/// Relative tolerance: sums of a hundred squares in another order.
const ANOTHER_ORDER: f64 = 1e-12;

fn every_parameter(n_links: usize, n_targets: usize) -> Vec<Parameter> {
    let quantities = [
        Quantity::A,
        Quantity::Alpha,
        Quantity::D,
        Quantity::ThetaOffset,
        Quantity::Beta,
    ];
    let links =
        (0..n_links).flat_map(|link| quantities.map(|quantity| Parameter::Link(link, quantity)));
    let base = (0..3).flat_map(|axis| {
        [
            Parameter::BaseTranslation(axis),
            Parameter::BaseRotation(axis),
        ]
    });
    links
        .chain(base)
        .chain(
            (0..n_targets)
                .flat_map(|target| (0..3).map(move |axis| Parameter::Target(target, axis))),
        )
        .collect()
}

/// A space around a random robot, and poses on its targets in turn; no target has a multiple of eight.
fn case(
    random: &mut ChaCha8Rng,
    n_links: usize,
    n_targets: usize,
) -> (SearchSpace, Vec<Observation>) {
    let reference = random_model(random, n_links, n_targets);
    let observations = (0..29)
        .map(|i| {
            let q_rad = random_q(random, n_links);
            let noise = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
            let position_mm = reference.position(&q_rad, i % n_targets) + noise;
            Observation {
                q_rad,
                position_mm,
                target: i % n_targets,
                weight: random.random_range(0.1..2.0),
                whitening: None,
                rotation: None,
                station: None,
            }
        })
        .collect();
    let parameters = every_parameter(n_links, n_targets);
    let scale = parameters
        .iter()
        .map(|p| if p.is_angle() { 0.02 } else { 1.5 })
        .collect();
    (SearchSpace::raw(reference, parameters, scale), observations)
}

/// Rows of the observations in the order of [`kincal::kinematics::batch::PoseLanes`]: target by target, in groups of eight.
fn rows_of(observations: &[Observation], n_targets: usize) -> Vec<usize> {
    let mut rows = vec![0; observations.len()];
    let (mut chunks, mut last) = (0, vec![(0, 8); n_targets]);
    for (row, o) in rows.iter_mut().zip(observations) {
        let (chunk, lane) = last[o.target];
        let place = if lane == 8 {
            (chunks, 0)
        } else {
            (chunk, lane)
        };
        chunks += usize::from(lane == 8);
        *row = place.0 * 24 + place.1;
        last[o.target] = (place.0, place.1 + 1);
    }
    rows
}

#[test]
fn residuals_and_derivatives_equal_the_readable_ones_for_any_robot() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    for n_links in 1..=12 {
        for n_targets in [1, 3] {
            let (space, observations) = case(&mut random, n_links, n_targets);
            let z: Vec<f64> = (0..space.n_coordinates())
                .map(|_| random.random_range(-1.0..1.0))
                .collect();
            let mut fast = Linearisation::new(&space, &observations);
            let (mut residuals, mut jacobian) = (
                DVector::zeros(fast.n_rows()),
                DMatrix::zeros(fast.n_rows(), z.len()),
            );
            fast.linearise(&z, residuals.as_mut_slice(), jacobian.as_mut_slice());
            let (model, deviation) = (space.model(&z), space.deviation(&z));
            let expected = weighted_residuals(&model, &observations);
            let turned = space.base_rotation(&deviation);
            let by_coordinate =
                -weighted_jacobian(&model, &space.parameters, &observations, &turned)
                    * space.directions();
            for (i, row) in rows_of(&observations, n_targets).into_iter().enumerate() {
                for axis in 0..3 {
                    let (fast, readable) = (residuals[row + 8 * axis], expected[3 * i + axis]);
                    assert!(
                        (fast - readable).abs() < ROUNDING_MM,
                        "{n_links} links, pose {i}: {fast} and {readable}"
                    );
                    for k in 0..z.len() {
                        let (fast, readable) = (
                            jacobian[(row + 8 * axis, k)],
                            by_coordinate[(3 * i + axis, k)],
                        );
                        let name = space.parameters[k].name();
                        assert!(
                            (fast - readable).abs() < ROUNDING_MM,
                            "{n_links} links, pose {i}, {name}: {fast} and {readable}"
                        );
                    }
                }
            }
            // The padding of incomplete chunks does not count.
            assert!(
                (residuals.norm_squared() / expected.norm_squared() - 1.0).abs() < ANOTHER_ORDER
            );
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_residuals_and_derivatives() {
    let mut random = ChaCha8Rng::seed_from_u64(12);
    let (space, observations) = case(&mut random, 6, 3);
    let z: Vec<f64> = (0..space.n_coordinates())
        .map(|_| random.random_range(-1.0..1.0))
        .collect();
    let on = |instructions: InstructionSet| {
        let mut fast = Linearisation::new(&space, &observations).with_instructions(instructions);
        let (mut residuals, mut alone, mut jacobian) = (
            vec![0.0; fast.n_rows()],
            vec![0.0; fast.n_rows()],
            vec![0.0; fast.n_rows() * z.len()],
        );
        fast.linearise(&z, &mut residuals, &mut jacobian);
        fast.residuals(&z, &mut alone);
        assert_eq!(
            bits(&alone),
            bits(&residuals),
            "with and without derivatives, {instructions:?}"
        );
        (bits(&residuals), bits(&jacobian))
    };
    let plain = on(InstructionSet::Baseline);
    for instructions in InstructionSet::all_here() {
        assert!(on(instructions) == plain, "{instructions:?}");
    }
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}
