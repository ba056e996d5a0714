//! The same bits on every CPU and in every build profile: results are pinned to the last bit. A change of an algorithm
//! may change them; another compiler, flag or machine must not.

use super::nist::problems;
use kincal::solvers::{bpnn, least_squares, pso, random::LaneRandom};
use std::ops::ControlFlow;

/// Hash of all bits of the numbers (FNV-1a).
fn fingerprint<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> u64 {
    let bytes = numbers
        .into_iter()
        .flat_map(|number| number.to_bits().to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[test]
fn random_numbers_keep_their_bits() {
    let mut numbers = [0.0; 1000];
    LaneRandom::new(42, 7).fill(&mut numbers);
    assert_eq!(fingerprint(&numbers), RANDOM);
}

#[test]
fn a_swarm_keeps_its_bits() {
    let mut cost = |positions: &pso::Positions, costs: &mut [f64]| {
        for (i, cost) in costs.iter_mut().enumerate() {
            let x = positions.particle(i);
            *cost = x.windows(2).fold(0.0, |sum, w| {
                sum + 100.0 * (w[1] - w[0] * w[0]) * (w[1] - w[0] * w[0])
                    + (1.0 - w[0]) * (1.0 - w[0])
            });
        }
    };
    let search_box = pso::SearchBox {
        centre: vec![0.1; 7],
        half_width: vec![1.7; 7],
    };
    let options = pso::Options {
        n_particles: 37,
        n_iterations: 100,
        seed: 3,
        ..pso::Options::default()
    };
    let summary = pso::minimize(&mut cost, &search_box, &options, None, &mut |_| {
        ControlFlow::Continue(())
    });
    assert_eq!(
        fingerprint(
            summary
                .own_best_positions
                .values
                .iter()
                .chain(&summary.convergence)
        ),
        SWARM
    );
}

#[test]
fn least_squares_keep_their_bits() {
    let problem = problems()
        .into_iter()
        .find(|problem| problem.name == "Thurber")
        .expect("it is in the file");
    let summary = least_squares::minimize(
        &mut |b, r, j| problem.evaluate(b, r, j),
        problem.data.len(),
        &problem.starts[0],
        &least_squares::Options::default(),
        &mut |_| ControlFlow::Continue(()),
    );
    assert_eq!(
        fingerprint(summary.x.iter().chain(&summary.convergence)),
        MIN_SQUARES
    );
}

#[test]
fn networks_keep_their_bits() {
    let mut random = LaneRandom::new(1, 1);
    let mut rows = |n_columns: usize| -> Vec<Vec<f64>> {
        let row = |_| {
            let mut numbers = vec![0.0; n_columns];
            random.fill(&mut numbers);
            numbers
        };
        (0..50).map(row).collect()
    };
    let (inputs, targets) = (rows(6), rows(3));
    let options = bpnn::Options {
        n_epochs: 100,
        n_trial_epochs: 20,
        seed: 5,
        ..bpnn::Options::default()
    };
    let (network, choice) = bpnn::choose_size_and_train(&inputs, &targets, &options);
    let weights = network.hidden_weights.iter().chain(&network.output_weights);
    let numbers = weights.chain([&choice.validation_error]);
    assert_eq!(fingerprint(numbers), NETWORKS);
}

const RANDOM: u64 = 2_947_509_739_510_288_248;
const SWARM: u64 = 12_737_460_306_616_367_052;
const MIN_SQUARES: u64 = 5_771_292_170_190_846_700;
const NETWORKS: u64 = 18_119_376_138_399_358_786;
