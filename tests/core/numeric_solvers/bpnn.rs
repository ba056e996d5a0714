//! The network, compared with a plain implementation; its gradient, compared with differences; and its training.

use kincal::solvers::bpnn::{
    Network, Options, Termination, choose_size_and_train, error_and_gradient,
    hidden_size_candidates, initial_network, mean_squared_error, train, train_from,
};
use kincal::solvers::random::LaneRandom;

/// Rows of uniform numbers in ± 1.
fn rows(n_rows: usize, n_columns: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = LaneRandom::new(seed, 100);
    let row = |_| {
        let mut numbers = vec![0.0; n_columns];
        random.fill(&mut numbers);
        numbers.iter().map(|u| 2.0 * u - 1.0).collect()
    };
    (0..n_rows).map(row).collect()
}

/// The production case: 200 particles of 24 coordinates, all with the same answer, here within ± `scale` of the centre.
fn one_answer(scale: f64) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let answer: Vec<f64> = rows(1, 24, 2)[0].iter().map(|x| scale * x).collect();
    (rows(200, 24, 1), vec![answer; 200])
}

/// [Gao 2018, eq. 12] neuron by neuron.
fn plain_answer(network: &Network, input: &[f64]) -> Vec<f64> {
    let neuron = |weights: &[f64], x: &[f64], threshold: f64| -> f64 {
        weights.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() - threshold
    };
    let hidden: Vec<f64> = (0..network.n_hidden)
        .map(|i| {
            let weights = &network.hidden_weights[i * network.n_inputs..(i + 1) * network.n_inputs];
            libm::tanh(neuron(weights, input, network.hidden_thresholds[i]))
        })
        .collect();
    (0..network.n_outputs)
        .map(|i| {
            let weights = &network.output_weights[i * network.n_hidden..(i + 1) * network.n_hidden];
            neuron(weights, &hidden, network.output_thresholds[i])
        })
        .collect()
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

/// Sizes that do not fill tiles and blocks of lanes, and sizes that do.
const SIZES: [(usize, usize, usize, usize); 3] = [(11, 5, 7, 3), (16, 8, 4, 4), (1, 1, 1, 1)];

#[test]
fn answers_are_those_of_a_plain_network() {
    /// Tolerance for sums of a dozen terms of order one.
    const ROUNDING: f64 = 1e-14;
    for (n_samples, n_inputs, n_hidden, n_outputs) in SIZES {
        let options = Options {
            seed: 4,
            ..Options::default()
        };
        let network = initial_network(n_inputs, n_hidden, n_outputs, &options);
        let inputs = rows(n_samples, n_inputs, 9);
        let answers = network.evaluate_all(&inputs);
        for (input, answer) in inputs.iter().zip(&answers) {
            assert!(largest_difference(answer, &plain_answer(&network, input)) < ROUNDING);
            assert_eq!(&network.evaluate(input), answer, "alone or among others");
        }
    }
}

#[test]
fn the_error_is_the_mean_square_over_samples_and_outputs() {
    for (n_samples, n_inputs, n_hidden, n_outputs) in SIZES {
        let network = initial_network(n_inputs, n_hidden, n_outputs, &Options::default());
        let (inputs, targets) = (rows(n_samples, n_inputs, 9), rows(n_samples, n_outputs, 10));
        let squares: f64 = inputs
            .iter()
            .zip(&targets)
            .flat_map(|(input, target)| {
                plain_answer(&network, input)
                    .into_iter()
                    .zip(target)
                    .map(|(a, t)| (a - t) * (a - t))
                    .collect::<Vec<_>>()
            })
            .sum();
        let expected = squares / (n_samples * n_outputs) as f64;
        assert!(
            (mean_squared_error(&network, &inputs, &targets) - expected).abs()
                < 1e-14 * expected.max(1.0)
        );
    }
}

/// The weights and thresholds of a network as one list.
fn parameters(network: &mut Network) -> [&mut Vec<f64>; 4] {
    [
        &mut network.hidden_weights,
        &mut network.hidden_thresholds,
        &mut network.output_weights,
        &mut network.output_thresholds,
    ]
}

#[test]
fn the_back_propagated_gradient_agrees_with_central_differences() {
    /// Step h of the differences; their error is about h² = 1e-10 plus rounding / h = 1e-11.
    const STEP: f64 = 1e-5;
    const TOLERANCE: f64 = 1e-9;
    for (n_samples, n_inputs, n_hidden, n_outputs) in SIZES {
        let options = Options {
            seed: 6,
            ..Options::default()
        };
        let mut network = initial_network(n_inputs, n_hidden, n_outputs, &options);
        let (inputs, targets) = (rows(n_samples, n_inputs, 9), rows(n_samples, n_outputs, 10));
        let (error, mut gradient) = error_and_gradient(&network, &inputs, &targets);
        assert_eq!(error, mean_squared_error(&network, &inputs, &targets));
        for part in 0..4 {
            for k in 0..parameters(&mut network)[part].len() {
                let mut error_at = |step: f64| {
                    parameters(&mut network)[part][k] += step;
                    let error = mean_squared_error(&network, &inputs, &targets);
                    parameters(&mut network)[part][k] -= step;
                    error
                };
                let difference = (error_at(STEP) - error_at(-STEP)) / (2.0 * STEP);
                let derivative = parameters(&mut gradient)[part][k];
                assert!(
                    (difference - derivative).abs() < TOLERANCE,
                    "part {part}, {k}: {derivative} or {difference}"
                );
            }
        }
    }
}

#[test]
fn a_sample_of_weight_two_counts_like_two_samples() {
    /// Both sums have the same terms in another order, over fifty updates.
    const TOLERANCE: f64 = 1e-9;
    let options = Options {
        seed: 7,
        n_epochs: 50,
        ..Options::default()
    };
    let (mut inputs, mut targets) = (rows(11, 3, 12), rows(11, 2, 13));
    let mut weights = vec![1.0; 11];
    (weights[2], weights[5]) = (2.0, 0.0);
    let first = initial_network(3, 4, 2, &options);
    let (weighted, _) = train_from(first.clone(), &inputs, &targets, &weights, &options);
    (inputs[5], targets[5]) = (inputs[2].clone(), targets[2].clone());
    let (repeated, _) = train_from(first, &inputs, &targets, &[1.0; 11], &options);
    for (a, b) in weighted
        .evaluate_all(&inputs)
        .iter()
        .zip(repeated.evaluate_all(&inputs))
    {
        assert!(
            a.iter().zip(&b).all(|(a, b)| (a - b).abs() < TOLERANCE),
            "{a:?} and {b:?}"
        );
    }
}

#[test]
fn ten_sizes_are_tried_from_the_rule_of_the_paper() {
    assert_eq!(
        hidden_size_candidates(24, 24),
        [8, 9, 10, 11, 12, 13, 14, 15, 16, 17]
    );
    assert_eq!(
        hidden_size_candidates(2, 1),
        [3, 4, 5, 6, 7, 8, 9, 10, 11, 12]
    );
}

#[test]
fn a_curved_surface_is_learnt() {
    /// Limit: a hundredth of 0.1, the error of a fitted plane, so the network must be nonlinear.
    const LEARNT: f64 = 1e-3;
    let surface = |inputs: &[Vec<f64>]| -> Vec<Vec<f64>> {
        inputs
            .iter()
            .map(|x| vec![libm::sin(3.0 * x[0]) * x[1]])
            .collect()
    };
    let (inputs, fresh) = (rows(200, 2, 20), rows(300, 2, 21));
    let options = Options {
        n_epochs: 6000,
        ..Options::default()
    };
    let (network, summary) = train(&inputs, &surface(&inputs), 10, &options);
    let unseen = mean_squared_error(&network, &fresh, &surface(&fresh));
    assert!(
        summary.training_error < LEARNT && unseen < 2.0 * LEARNT,
        "{}, unseen {unseen}",
        summary.training_error
    );
}

#[test]
fn an_affine_map_of_24_coordinates_is_learnt() {
    /// Limit: one part in 5000 of the targets' variance, 0.3.
    const LEARNT: f64 = 6e-5;
    let matrix = rows(24, 24, 30);
    let map = |inputs: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let answer = |x: &Vec<f64>| {
            matrix
                .iter()
                .map(|row| 0.3 + 0.2 * row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>())
                .collect()
        };
        inputs.iter().map(answer).collect()
    };
    let (inputs, fresh) = (rows(400, 24, 31), rows(100, 24, 32));
    let (network, summary) = train(
        &inputs,
        &map(&inputs),
        28,
        &Options {
            n_epochs: 3000,
            ..Options::default()
        },
    );
    let unseen = mean_squared_error(&network, &fresh, &map(&fresh));
    assert!(
        summary.training_error < LEARNT && unseen < 3.0 * LEARNT,
        "{}, unseen {unseen}",
        summary.training_error
    );
}

#[test]
fn a_constant_answer_is_predicted_wherever_it_lies_and_not_to_a_single_point() {
    /// Limits in units of the search box. A thousandth of a box of 1 mm is a micrometre; below a millionth the
    /// particles of the next swarm would all be at one point.
    const FAR: f64 = 3e-3;
    const COLLAPSED: f64 = 1e-6;
    for scale in [0.2, 1.0, 4.0] {
        let (inputs, targets) = one_answer(scale);
        let (network, summary) = train(
            &inputs,
            &targets,
            8,
            &Options {
                n_epochs: 3000,
                ..Options::default()
            },
        );
        let distance = |answer: &Vec<f64>| {
            answer
                .iter()
                .zip(&targets[0])
                .map(|(a, t)| (a - t) * (a - t))
                .sum::<f64>()
                .sqrt()
        };
        let mut distances: Vec<f64> = network.evaluate_all(&inputs).iter().map(distance).collect();
        distances.sort_by(f64::total_cmp);
        let (low, median, high) = (distances[20], distances[100], distances[180]);
        println!(
            "answer within {scale}: median {median:.1e}, 10 % {low:.1e}, 90 % {high:.1e}, mse {:.1e}",
            summary.training_error
        );
        assert!(
            high < FAR && low > COLLAPSED,
            "scale {scale}: {low:e} … {high:e}"
        );
    }
}

#[test]
fn the_network_with_the_smallest_error_seen_is_returned() {
    let (inputs, targets) = (rows(30, 3, 50), rows(30, 2, 51));
    let trained = |n_epochs: usize| {
        let options = Options {
            n_epochs,
            ..Options::default()
        };
        train(&inputs, &targets, 4, &options)
    };
    // the first training that does not end at its best
    let (_, longest) = trained(300);
    let n_epochs = (1..300)
        .find(|n| longest.convergence[*n] > longest.convergence[n - 1])
        .expect("one step goes uphill");
    let (network, summary) = trained(n_epochs);
    let smallest = summary
        .convergence
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    assert!(summary.convergence[n_epochs] > smallest);
    assert_eq!(summary.training_error, smallest);
    assert_eq!(mean_squared_error(&network, &inputs, &targets), smallest);
    assert_eq!(
        (
            summary.n_epochs,
            summary.convergence.len(),
            summary.termination
        ),
        (n_epochs, n_epochs + 1, Termination::EpochLimit)
    );
}

#[test]
fn training_stops_at_the_error_asked_for() {
    let (inputs, targets) = one_answer(1.0);
    let options = Options {
        target_error: 1e-3,
        ..Options::default()
    };
    let (_, summary) = train(&inputs, &targets, 8, &options);
    assert_eq!(summary.termination, Termination::ErrorReached);
    assert!(summary.training_error <= 1e-3 && summary.n_epochs < options.n_epochs);
    assert!(
        summary.convergence[..summary.n_epochs]
            .iter()
            .all(|&error| error > 1e-3)
    );
}

#[test]
fn the_size_that_predicts_best_is_chosen_and_ties_go_to_the_smaller() {
    let (inputs, targets) = (rows(60, 3, 60), rows(60, 2, 61));
    let options = Options {
        n_epochs: 50,
        n_trial_epochs: 30,
        tie_factor: 1.0,
        ..Options::default()
    };
    let (network, choice) = choose_size_and_train(&inputs, &targets, &options);
    assert_eq!(
        choice
            .candidates
            .iter()
            .map(|c| c.n_hidden)
            .collect::<Vec<_>>(),
        hidden_size_candidates(3, 2)
    );
    let smallest = choice
        .candidates
        .iter()
        .map(|c| c.validation_error)
        .fold(f64::INFINITY, f64::min);
    let best = choice
        .candidates
        .iter()
        .find(|c| c.validation_error == smallest)
        .expect("one of them");
    assert_eq!(
        (choice.n_hidden, choice.validation_error),
        (best.n_hidden, smallest)
    );
    assert_eq!(
        network,
        train(&inputs, &targets, best.n_hidden, &options).0,
        "then trained on all samples"
    );
    assert_eq!(
        choice.training_error,
        mean_squared_error(&network, &inputs, &targets)
    );

    let (_, all_tied) = choose_size_and_train(
        &inputs,
        &targets,
        &Options {
            tie_factor: 1e9,
            ..options
        },
    );
    assert_eq!(all_tied.n_hidden, all_tied.candidates[0].n_hidden);
}

#[test]
fn one_sample_is_enough() {
    let options = Options {
        n_epochs: 200,
        n_trial_epochs: 10,
        ..Options::default()
    };
    let (network, choice) = choose_size_and_train(&[vec![0.5, -0.5]], &[vec![1.5]], &options);
    assert!(
        (network.evaluate(&[0.5, -0.5])[0] - 1.5).abs() < 1e-3
            && choice.validation_error.is_finite()
    );
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let (inputs, targets) = (rows(40, 4, 70), rows(40, 3, 71));
    let options = Options {
        n_epochs: 50,
        n_trial_epochs: 20,
        seed: 1,
        ..Options::default()
    };
    let first = choose_size_and_train(&inputs, &targets, &options);
    assert_eq!(first, choose_size_and_train(&inputs, &targets, &options));
    assert_ne!(
        first.0.hidden_weights,
        choose_size_and_train(&inputs, &targets, &Options { seed: 2, ..options })
            .0
            .hidden_weights
    );
}

#[test]
fn a_swarms_network_is_chosen_and_trained() {
    let (inputs, targets) = one_answer(1.0);
    let (_, choice) = choose_size_and_train(&inputs, &targets, &Options::default());
    assert!(choice.training_error < 1e-6, "{}", choice.training_error);
}
