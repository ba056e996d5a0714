//! Back-propagation training over all samples at once.

use super::kernel::{Gradient, Pass, Samples};
use super::{Network, Options};
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
        &vec![1.0; inputs.len()],
        options,
    )
}

/// As [`train`], starting from an existing network. Each sample's squared errors count with its weight.
///
/// # Panics
/// As [`train`], and when rows do not fit the network.
pub fn train_from(
    mut network: Network,
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
    weights: &[f64],
    options: &Options,
) -> (Network, TrainingSummary) {
    assert!(
        !inputs.is_empty() && inputs.len() == targets.len() && inputs.len() == weights.len(),
        "at least one input, and one target and weight per input"
    );
    let (n_inputs, n_outputs) = (network.n_inputs, network.n_outputs);
    assert!(
        inputs.iter().all(|row| row.len() == n_inputs)
            && targets.iter().all(|row| row.len() == n_outputs),
        "rows of one length"
    );
    let (mut pass, mut gradient) = (Pass::weighted(&network, weights), Gradient::zeros(&network));
    let (inputs, targets) = (
        Samples::from_rows(inputs, n_inputs),
        Samples::from_rows(targets, n_outputs),
    );
    let mut memories = Memories::new(&network);
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
        memories.update(&mut network, &gradient);
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

/// First step of every weight.
const INITIAL_STEP: f64 = 0.01;
/// Longest step of a weight.
const LARGEST_STEP: f64 = 1.0;

/// Memory of the update of each weight.
struct Memory {
    steps: Vec<f64>,
    last_gradient: Vec<f64>,
}

struct Memories([Memory; 4]);

impl Memories {
    fn new(network: &Network) -> Self {
        let of = |weights: &[f64]| Memory {
            steps: vec![INITIAL_STEP; weights.len()],
            last_gradient: vec![0.0; weights.len()],
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

    fn update(&mut self, network: &mut Network, gradient: &Gradient) {
        let [a, b, c, d] = &mut self.0;
        rprop(&mut network.hidden_weights, &gradient.hidden_weights, a);
        rprop(
            &mut network.hidden_thresholds,
            &gradient.hidden_thresholds,
            b,
        );
        rprop(&mut network.output_weights, &gradient.output_weights, c);
        rprop(
            &mut network.output_thresholds,
            &gradient.output_thresholds,
            d,
        );
    }
}

/// iRprop⁻ [Igel, Hüsken 2000: Improving the Rprop learning algorithm]: every weight has its own step. The step grows by 1.2 while the sign
/// of the weight's gradient stays the same. It halves when the sign changes; the weight is then not changed for one epoch. The rule needs
/// no learning rate, so it works equally well for targets inside the search box and far outside. If all targets are equal, the network
/// comes close to the target and still gives different answers for different inputs.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
fn rprop(weights: &mut [f64], gradient: &[f64], memory: &mut Memory) {
    let n = weights.len();
    let (gradient, steps, last) = (
        &gradient[..n],
        &mut memory.steps[..n],
        &mut memory.last_gradient[..n],
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
        steps[i] = (steps[i] * factor).min(LARGEST_STEP);
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
