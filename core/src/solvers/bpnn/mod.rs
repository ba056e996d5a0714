//! A network with one hidden layer, trained by back-propagation [Gao 2018, section 3.2].
//!
//! Each neuron is P = f(Σ w_ij x_j − T_j) [Gao 2018, eq. 12], f = tanh in the hidden layer and f(x) = x in the output layer: answers may lie outside ±1, because the
//! targets are scaled by a search box that the swarm may leave. Inputs and targets are already scaled (positions by the
//! half width of their search box), with one row per sample.

mod kernel;
mod network;
mod size;
mod tanh;
mod training;

pub use network::Network;
pub use size::{Candidate, SizeChoice, choose_size_and_train, hidden_size_candidates};
pub use training::{
    Termination, TrainingSummary, error_and_gradient, initial_network, mean_squared_error, train,
    train_from,
};

use kernel::{Pass, Samples};

impl Network {
    /// The answer to one input [Gao 2018, eq. 12].
    ///
    /// # Panics
    /// When `input` has another length than the network has inputs.
    pub fn evaluate(&self, input: &[f64]) -> Vec<f64> {
        self.evaluate_all(&[input.to_vec()]).remove(0)
    }

    /// The answers to many inputs, one row each.
    ///
    /// # Panics
    /// When a row has another length than the network has inputs.
    pub fn evaluate_all(&self, inputs: &[Vec<f64>]) -> Vec<Vec<f64>> {
        assert!(
            inputs.iter().all(|row| row.len() == self.n_inputs),
            "one value per input"
        );
        let mut pass = Pass::new(self, inputs.len());
        let outputs = pass.forward(self, &Samples::from_rows(inputs, self.n_inputs));
        (0..inputs.len()).map(|i| outputs.row(i)).collect()
    }
}

/// Options of the training, and of the choice of the size by [`choose_size_and_train`]. The paper prints none of these numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Maximum number of passes over all samples: 10,000. In a swarm's follow-up, a well trained network is better than a half trained one.
    pub n_epochs: usize,
    /// Training stops when the mean squared error is at or below this: 0, so only if every answer is exact.
    pub target_error: f64,
    /// λ: λ·Σ w² over the weights, without thresholds, is added to the error: 0. A prior of width one for the weights corresponds to λ equal to the
    /// noise variance divided by samples × outputs.
    pub weight_decay: f64,
    /// Seed of the first weights, and of the split into training and validation: 0.
    pub seed: u64,
    /// Share of the samples that are held out from training while sizes are compared: 0.2.
    pub validation_fraction: f64,
    /// Number of epochs for each size that is tried: 300. By then, sizes differ by more than their initial weights do.
    pub n_trial_epochs: usize,
    /// Sizes whose validation error is within this factor of the smallest are equally good; the smallest size wins: 1.1.
    pub tie_factor: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            n_epochs: 10_000,
            target_error: 0.0,
            weight_decay: 0.0,
            seed: 0,
            validation_fraction: 0.2,
            n_trial_epochs: 300,
            tie_factor: 1.1,
        }
    }
}
