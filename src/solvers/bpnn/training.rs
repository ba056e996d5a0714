//! Back-propagation training over all samples at once.

use super::kernel::{Gradient, Pass, Samples};
use super::{Network, Options, UpdateRule};
use crate::solvers::random::{chacha8, unit_interval};
use multiversion::multiversion;
use rand::Rng;

/// Separates this use of a seed from others.
const STREAM_INITIAL_WEIGHTS: u64 = 10;

/// Why training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// All epochs were done.
    EpochLimit,
    /// The error reached [`Options::target_error`].
    ErrorReached,
}

/// Summary of a training.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingSummary {
    /// Number of weight updates.
    pub n_epochs: usize,
    /// Mean squared error of the returned network, over samples and outputs, including the decay of its weights.
    pub training_error: f64,
    /// Mean squared error before each update, and after the last one.
    pub convergence: Vec<f64>,
    /// Why training ended.
    pub termination: Termination,
}

/// An untrained network: all weights and thresholds uniform within ± 1/√(neurons of the layer before).
pub fn initial_network(
    n_inputs: usize,
    n_hidden: usize,
    n_outputs: usize,
    options: &Options,
) -> Network {
    let mut random = chacha8(options.seed, STREAM_INITIAL_WEIGHTS);
    let mut draw = |count: usize, fan_in: usize| -> Vec<f64> {
        let limit = 1.0 / (fan_in.max(1) as f64).sqrt();
        (0..count)
            .map(|_| limit * (2.0 * unit_interval(random.next_u64()) - 1.0))
            .collect()
    };
    Network {
        n_inputs,
        n_hidden,
        n_outputs,
        hidden_weights: draw(n_hidden * n_inputs, n_inputs),
        hidden_thresholds: draw(n_hidden, n_inputs),
        output_weights: draw(n_outputs * n_hidden, n_hidden),
        output_thresholds: draw(n_outputs, n_hidden),
        output_activation: options.output_activation,
    }
}

/// Mean squared error over samples and outputs.
pub fn mean_squared_error(network: &Network, inputs: &[Vec<f64>], targets: &[Vec<f64>]) -> f64 {
    let mut pass = Pass::new(network, inputs.len());
    pass.forward(network, &Samples::from_rows(inputs, network.n_inputs));
    pass.error(network, &Samples::from_rows(targets, network.n_outputs))
}

/// Mean squared error and its gradient by back-propagation. The gradient has the form of a network whose weights are derivatives.
pub fn error_and_gradient(
    network: &Network,
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
) -> (f64, Network) {
    let (mut pass, mut gradient) = (Pass::new(network, inputs.len()), Gradient::zeros(network));
    let inputs = Samples::from_rows(inputs, network.n_inputs);
    pass.forward(network, &inputs);
    let error = pass.backward(
        network,
        &inputs,
        &Samples::from_rows(targets, network.n_outputs),
        &mut gradient,
    );
    let Gradient {
        hidden_weights,
        hidden_thresholds,
        output_weights,
        output_thresholds,
    } = gradient;
    (
        error,
        Network {
            hidden_weights,
            hidden_thresholds,
            output_weights,
            output_thresholds,
            ..network.clone()
        },
    )
}

/// Trains a network with `n_hidden` hidden neurons on all samples (rows of `inputs` and `targets`).
///
/// Returns the network with the smallest error seen. Only the number of epochs limits the time.
///
/// # Panics
/// When there are no samples, or inputs and targets differ in number, or rows in length.
pub fn train(
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
    n_hidden: usize,
    options: &Options,
) -> (Network, TrainingSummary) {
    assert!(
        !inputs.is_empty() && inputs.len() == targets.len(),
        "at least one input, and one target per input"
    );
    train_from(
        initial_network(inputs[0].len(), n_hidden, targets[0].len(), options),
        inputs,
        targets,
        options,
    )
}

/// As [`train`], starting from an existing network.
///
/// # Panics
/// As [`train`], and when rows do not fit the network.
pub fn train_from(
    mut network: Network,
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
    options: &Options,
) -> (Network, TrainingSummary) {
    assert!(
        !inputs.is_empty() && inputs.len() == targets.len(),
        "at least one input, and one target per input"
    );
    let (n_inputs, n_outputs) = (network.n_inputs, network.n_outputs);
    assert!(
        inputs.iter().all(|row| row.len() == n_inputs)
            && targets.iter().all(|row| row.len() == n_outputs),
        "rows of one length"
    );
    let (mut pass, mut gradient) = (Pass::new(&network, inputs.len()), Gradient::zeros(&network));
    let (inputs, targets) = (
        Samples::from_rows(inputs, n_inputs),
        Samples::from_rows(targets, n_outputs),
    );
    let mut memories = Memories::new(&network, options.update_rule);
    let mut convergence = Vec::with_capacity(options.n_epochs.min(100_000) + 1);
    let mut best = (f64::INFINITY, network.clone());
    let termination = loop {
        pass.forward(&network, &inputs);
        let mut error = pass.backward(&network, &inputs, &targets, &mut gradient);
        if options.weight_decay > 0.0 {
            error += decay(&network, &mut gradient, options.weight_decay);
        }
        convergence.push(error);
        if error < best.0 {
            best.0 = error;
            best.1.clone_from(&network);
        }
        if error <= options.target_error {
            break Termination::ErrorReached;
        }
        if convergence.len() > options.n_epochs {
            break Termination::EpochLimit;
        }
        memories.update(&mut network, &gradient, convergence.len(), options);
    };
    let summary = TrainingSummary {
        n_epochs: convergence.len() - 1,
        training_error: best.0,
        convergence,
        termination,
    };
    (best.1, summary)
}

/// Adds the gradient of λ·Σ w² over the weights (not thresholds) to `gradient`, and returns λ·Σ w².
fn decay(network: &Network, gradient: &mut Gradient, lambda: f64) -> f64 {
    let mut sum = 0.0;
    let pairs = [
        (&network.hidden_weights, &mut gradient.hidden_weights),
        (&network.output_weights, &mut gradient.output_weights),
    ];
    for (weights, gradient) in pairs {
        for (weight, slope) in weights.iter().zip(gradient) {
            *slope = (2.0 * lambda).mul_add(*weight, *slope);
            sum = weight.mul_add(*weight, sum);
        }
    }
    lambda * sum
}

/// Memory of an update rule for each weight: step and last gradient for Rprop, two means for Adam, the last change for momentum.
struct Memory {
    first: Vec<f64>,
    second: Vec<f64>,
}

struct Memories([Memory; 4]);

impl Memories {
    fn new(network: &Network, rule: UpdateRule) -> Self {
        let first = if let UpdateRule::Rprop { initial_step, .. } = rule {
            initial_step
        } else {
            0.0
        };
        let of = |weights: &[f64]| Memory {
            first: vec![first; weights.len()],
            second: vec![0.0; weights.len()],
        };
        Self(
            [
                &network.hidden_weights,
                &network.hidden_thresholds,
                &network.output_weights,
                &network.output_thresholds,
            ]
            .map(|w| of(w)),
        )
    }

    fn update(
        &mut self,
        network: &mut Network,
        gradient: &Gradient,
        epoch: usize,
        options: &Options,
    ) {
        let [a, b, c, d] = &mut self.0;
        for (weights, gradient, memory) in [
            (&mut network.hidden_weights, &gradient.hidden_weights, a),
            (
                &mut network.hidden_thresholds,
                &gradient.hidden_thresholds,
                b,
            ),
            (&mut network.output_weights, &gradient.output_weights, c),
            (
                &mut network.output_thresholds,
                &gradient.output_thresholds,
                d,
            ),
        ] {
            match options.update_rule {
                UpdateRule::Rprop { largest_step, .. } => {
                    rprop(weights, gradient, memory, largest_step)
                }
                UpdateRule::Adam { learning_rate } => {
                    let left = 1.0 - (epoch - 1) as f64 / options.n_epochs as f64;
                    adam(weights, gradient, memory, learning_rate * left, epoch);
                }
                UpdateRule::Momentum {
                    learning_rate,
                    momentum,
                } => momentum_step(weights, gradient, memory, learning_rate, momentum),
            }
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn momentum_step(
    weights: &mut [f64],
    gradient: &[f64],
    memory: &mut Memory,
    learning_rate: f64,
    momentum: f64,
) {
    for ((weight, gradient), change) in weights.iter_mut().zip(gradient).zip(&mut memory.first) {
        *change = momentum.mul_add(*change, -learning_rate * gradient);
        *weight += *change;
    }
}

/// iRprop⁻: a weight whose gradient changed sign is not changed for one epoch.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn rprop(weights: &mut [f64], gradient: &[f64], memory: &mut Memory, largest_step: f64) {
    let n = weights.len();
    let (gradient, steps, last) = (
        &gradient[..n],
        &mut memory.first[..n],
        &mut memory.second[..n],
    );
    for i in 0..n {
        let agreement = gradient[i] * last[i];
        let factor = if agreement > 0.0 {
            1.2
        } else if agreement < 0.0 {
            0.5
        } else {
            1.0
        };
        steps[i] = (steps[i] * factor).min(largest_step);
        let followed = if agreement < 0.0 { 0.0 } else { gradient[i] };
        let direction = if followed > 0.0 {
            1.0
        } else if followed < 0.0 {
            -1.0
        } else {
            0.0
        };
        weights[i] -= direction * steps[i];
        last[i] = followed;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn adam(weights: &mut [f64], gradient: &[f64], memory: &mut Memory, rate: f64, epoch: usize) {
    const BETA_1: f64 = 0.9;
    const BETA_2: f64 = 0.999;
    let n = weights.len();
    let epoch = epoch as f64;
    let (bias_1, bias_2) = (
        1.0 - libm::pow(BETA_1, epoch),
        1.0 - libm::pow(BETA_2, epoch),
    );
    let (gradient, means, squares) = (
        &gradient[..n],
        &mut memory.first[..n],
        &mut memory.second[..n],
    );
    for i in 0..n {
        means[i] = BETA_1.mul_add(means[i], (1.0 - BETA_1) * gradient[i]);
        squares[i] = BETA_2.mul_add(squares[i], (1.0 - BETA_2) * gradient[i] * gradient[i]);
        let spread = (squares[i] / bias_2).sqrt();
        weights[i] -= if spread > 0.0 {
            rate * (means[i] / bias_1) / spread
        } else {
            0.0
        };
    }
}
