//! Chooses the number of hidden neurons by trying several [Gao 2018, section 3.2].

use super::training::{TrainingSummary, mean_squared_error, train};
use super::{Network, Options};
use crate::solvers::random::chacha8;
use rand::Rng;

/// Separates this use of a seed from others.
const STREAM_SPLIT: u64 = 11;

/// The sizes to try: round(√(m + n)) + a, a = 1 … 10, for n inputs and m outputs. The paper's print reads √(m + na);
/// this is the usual form of that rule.
pub fn hidden_size_candidates(n_inputs: usize, n_outputs: usize) -> Vec<usize> {
    let root = ((n_inputs + n_outputs) as f64).sqrt().round() as usize;
    (1..=10).map(|a| root + a).collect()
}

/// One size that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Number of hidden neurons.
    pub n_hidden: usize,
    /// Mean squared error on the samples it was trained on.
    pub training_error: f64,
    /// Mean squared error on the held-out samples.
    pub validation_error: f64,
}

/// Result of the choice of the size, and of the training.
#[derive(Clone, Debug, PartialEq)]
pub struct SizeChoice {
    /// All sizes that were tried, smallest first.
    pub candidates: Vec<Candidate>,
    /// Number of hidden neurons that was chosen.
    pub n_hidden: usize,
    /// Mean squared error of the network that was returned, on all samples.
    pub training_error: f64,
    /// Mean squared error of the chosen size in its trial, on the held-out samples.
    pub validation_error: f64,
    /// Training of the chosen size on all samples.
    pub training: TrainingSummary,
}

/// Briefly tries all sizes of [`hidden_size_candidates`] on a part of the samples, takes the one that best predicts the others, and trains that size
/// on all samples.
///
/// # Panics
/// When there are no samples, or inputs and targets differ in number, or rows in length.
pub fn choose_size_and_train(
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
    options: &Options,
) -> (Network, SizeChoice) {
    assert!(
        !inputs.is_empty() && inputs.len() == targets.len(),
        "at least one input, and one target per input"
    );
    let (training_rows, validation_rows) = split(inputs.len(), options);
    let select = |rows: &[usize], from: &[Vec<f64>]| -> Vec<Vec<f64>> {
        rows.iter().map(|&row| from[row].clone()).collect()
    };
    let (x, y) = (
        select(&training_rows, inputs),
        select(&training_rows, targets),
    );
    // a single sample is used for both training and validation
    let kept = if validation_rows.is_empty() {
        &training_rows
    } else {
        &validation_rows
    };
    let (x_kept, y_kept) = (select(kept, inputs), select(kept, targets));
    let trial = Options {
        n_epochs: options.n_trial_epochs,
        ..options.clone()
    };
    let sizes = hidden_size_candidates(inputs[0].len(), targets[0].len());
    let candidates: Vec<Candidate> = sizes
        .into_iter()
        .map(|n_hidden| {
            let (network, summary) = train(&x, &y, n_hidden, &trial);
            let validation_error = mean_squared_error(&network, &x_kept, &y_kept);
            Candidate {
                n_hidden,
                training_error: summary.training_error,
                validation_error,
            }
        })
        .collect();
    let Candidate {
        n_hidden,
        validation_error,
        ..
    } = choose(&candidates, options.tie_factor);
    let (network, training) = train(inputs, targets, n_hidden, options);
    (
        network,
        SizeChoice {
            candidates,
            n_hidden,
            training_error: training.training_error,
            validation_error,
            training,
        },
    )
}

/// The first (smallest) candidate within the tie factor of the smallest error.
fn choose(candidates: &[Candidate], tie_factor: f64) -> Candidate {
    let smallest = candidates
        .iter()
        .map(|candidate| candidate.validation_error)
        .fold(f64::INFINITY, f64::min);
    let chosen = candidates
        .iter()
        .find(|candidate| candidate.validation_error <= smallest * tie_factor);
    *chosen.unwrap_or(&candidates[0])
}

/// Rows for training and for validation: a seeded shuffle, then a cut.
fn split(n_samples: usize, options: &Options) -> (Vec<usize>, Vec<usize>) {
    let mut random = chacha8(options.seed, STREAM_SPLIT);
    let mut rows: Vec<usize> = (0..n_samples).collect();
    for last in (1..n_samples).rev() {
        let other = (random.next_u64() % (last as u64 + 1)) as usize; // biased by less than n / 2⁶⁴
        rows.swap(last, other);
    }
    let n_validation = (options.validation_fraction * n_samples as f64).round() as usize;
    let validation = rows.split_off(n_samples - n_validation.min(n_samples.saturating_sub(1)));
    (rows, validation)
}
