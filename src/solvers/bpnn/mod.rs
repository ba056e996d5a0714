//! A network with one hidden layer, trained by back-propagation [Gao 2018, section 3.2].
//!
//! Each neuron is P = f(Σ w_ij x_j − T_j) [Gao 2018, eq. 12], f = tanh in the hidden layer. Inputs and targets are already scaled (positions by the
//! half width of their search box), with one row per sample.

mod kernel;
mod network;
mod size;
mod tanh;
mod training;

pub use network::{Activation, Network};
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

/// How the gradient changes the weights. The paper says "trained by back-propagation" and no more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UpdateRule {
    /// iRprop⁻ [Igel, Hüsken 2000: Improving the Rprop learning algorithm]: every weight has its own step. The step grows by 1.2 while the sign of
    /// its gradient stays the same, and halves when the sign changes.
    Rprop {
        /// First step of every weight.
        initial_step: f64,
        /// Longest step.
        largest_step: f64,
    },
    /// Adam [Kingma, Ba 2015: Adam, a method for stochastic optimization], β₁ = 0.9, β₂ = 0.999, with a rate that falls linearly to zero over the
    /// epochs. It is the most accurate rule here. With equal targets it can go too far: hidden neurons saturate, every answer is the target to the
    /// last bit, and a swarm that is moved there cannot move on.
    Adam {
        /// First learning rate.
        learning_rate: f64,
    },
    /// The gradient with momentum, Δw <- momentum · Δw − rate · gradient: textbook back-propagation.
    Momentum {
        /// Learning rate.
        learning_rate: f64,
        /// Share of the last change that is added to the next.
        momentum: f64,
    },
}

/// Options of the training, and of the choice of the size by [`choose_size_and_train`]. The paper prints none of these numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Maximum number of passes over all samples: 10,000. In a swarm's follow-up, a well trained network is better than a half trained one.
    pub n_epochs: usize,
    /// Training stops when the mean squared error is at or below this: 0, so only if every answer is exact.
    pub target_error: f64,
    /// Update rule: iRprop⁻ from steps of 0.01 to at most 1. It needs no learning rate, so it works equally well for answers inside the search box
    /// and far outside. With equal targets it comes close without collapsing onto the target.
    pub update_rule: UpdateRule,
    /// f of the output neurons: the identity, see [`Activation`].
    pub output_activation: Activation,
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
            update_rule: UpdateRule::Rprop {
                initial_step: 0.01,
                largest_step: 1.0,
            },
            output_activation: Activation::Identity,
            weight_decay: 0.0,
            seed: 0,
            validation_fraction: 0.2,
            n_trial_epochs: 300,
            tie_factor: 1.1,
        }
    }
}
