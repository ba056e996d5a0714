//! The robot's residual network: from joint values to the errors that links and physics leave, trained by back-propagation on this robot alone.
//!
//! Its samples are the residuals of the points, in the base frame. A network that is large enough also fits noise. Its weights therefore have a prior
//! of width one (weight decay), and it is kept only if it wins on configurations that it has not seen.

use super::fit::{Fit, Setting};
use super::folds::{Evidence, Folds};
use crate::identification::model::objective::Observation;
use crate::kinematics::ResidualNetwork;
use crate::solvers::bpnn::{self, Network};
use nalgebra::Vector3;

/// Number of hidden neurons. With more than ten, unseen points of measured robots gain nothing.
const HIDDEN: usize = 10;
/// Number of passes over the samples.
const EPOCHS: usize = 300;
/// Minimum number of configurations. With fewer, too little is left for training after links and physical effects are identified.
const MIN_CONFIGURATIONS: usize = 30;
/// Maximum number of samples, evenly selected.
const MAX_SAMPLES: usize = 1_000;

/// Residuals of the cross-validation of the other corrections.
pub(super) struct FoldedResiduals<'a> {
    pub folds: &'a Folds,
    /// For each part left out: weighted residuals of all points.
    pub residuals: &'a [Vec<f64>],
    pub n_configurations: usize,
}

/// A network that was tried.
pub(super) struct Tried {
    pub evidence: Evidence,
    /// The network, if it won.
    pub network: Option<ResidualNetwork>,
}

/// Poses, their residuals in the base frame, mm, and their weights, of mean 1.
struct Samples {
    poses: Vec<Vec<f64>>,
    left_mm: Vec<Vector3<f64>>,
    weights: Vec<f64>,
}

/// Trains a network and evaluates it by cross-validation. `None` if there are too few samples, or if the residuals have no smooth part.
pub(super) fn choose_network(
    setting: &Setting<'_>,
    fit: &Fit<'_>,
    folded: &FoldedResiduals<'_>,
    earlier: Option<&ResidualNetwork>,
    seed: u64,
    go_on: &mut dyn FnMut() -> bool,
) -> Option<Tried> {
    let folds = folded.folds;
    if folded.n_configurations < MIN_CONFIGURATIONS || !neighbours_agree(setting, fit) {
        return None;
    }
    let left = |residuals: &[f64], point: usize| left_in_base(setting, fit, residuals, point);
    let mut errors = vec![0.0; setting.observations.len()];
    for fold in 0..folds.n_folds {
        if !go_on() {
            return None;
        }
        let residuals = &folded.residuals[fold];
        let (unseen, seen): (Vec<usize>, Vec<usize>) =
            (0..errors.len()).partition(|point| folds.folds[*point] == fold);
        let network = train_residual_network(
            &samples(setting, &seen, |point| left(residuals, point)),
            earlier,
            seed,
        )?;
        for point in unseen {
            let o = &setting.observations[point];
            let error = left(residuals, point) - network.displacement_mm(&o.q_rad);
            errors[point] = o.weight * whitened_from_base(fit, o, error).norm_squared();
        }
    }
    // The same division is used for both errors, so that differences between divisions are not attributed to the network.
    let before = folds.by_configuration(|point| {
        position_rows(fit, &folded.residuals[folds.folds[point]], point).norm_squared()
    });
    let after = folds.by_configuration(|point| errors[point]);
    let evidence = before.evidence(&after, "residual_network");
    if !evidence.kept {
        return Some(Tried {
            evidence,
            network: None,
        });
    }
    Some(Tried {
        evidence,
        network: Some(train_network(setting, fit, earlier, seed)?),
    })
}

/// The network trained on all points.
pub(super) fn train_network(
    setting: &Setting<'_>,
    fit: &Fit<'_>,
    earlier: Option<&ResidualNetwork>,
    seed: u64,
) -> Option<ResidualNetwork> {
    let residuals = residuals_at(fit);
    let all: Vec<usize> = (0..setting.observations.len()).collect();
    let left = |point| left_in_base(setting, fit, &residuals, point);
    train_residual_network(&samples(setting, &all, left), earlier, seed)
}

/// Weighted residuals of all points at a fit.
fn residuals_at(fit: &Fit<'_>) -> Vec<f64> {
    let mut residuals = vec![0.0; fit.problem.n_rows()];
    fit.problem.evaluate(&fit.estimate.x, &mut residuals, None);
    residuals
}

/// The position rows of a point.
fn position_rows(fit: &Fit<'_>, residuals: &[f64], point: usize) -> Vector3<f64> {
    let first = fit.problem.rows_of(point).start;
    Vector3::from_column_slice(&residuals[first..first + 3])
}

/// The residual of a point in the base frame, mm.
fn left_in_base(
    setting: &Setting<'_>,
    fit: &Fit<'_>,
    residuals: &[f64],
    point: usize,
) -> Vector3<f64> {
    let to_base = fit.estimate.model.t_instrument_base.rotation.inverse();
    let o = &setting.observations[point];
    let row = position_rows(fit, residuals, point);
    // The whitening matrix of a covariance is invertible.
    let whitening = o.whitening.and_then(|w| w.try_inverse());
    let row = whitening.map_or(row, |back| back * row);
    to_base * row / o.weight.sqrt()
}

/// Transforms a vector of the base frame to the rows of an observation, without their weight.
fn whitened_from_base(fit: &Fit<'_>, o: &Observation, v: Vector3<f64>) -> Vector3<f64> {
    match o.whitening {
        Some(w) => w * (fit.estimate.model.t_instrument_base.rotation * v),
        None => v,
    }
}

/// A fast check before training: if the residuals are a smooth function of the joints, those of neighbouring poses are similar. True if the
/// mean product with the residual of the nearest other configuration exceeds its standard error.
fn neighbours_agree(setting: &Setting<'_>, fit: &Fit<'_>) -> bool {
    let residuals = residuals_at(fit);
    let step = setting.observations.len().div_ceil(MAX_SAMPLES).max(1);
    let points: Vec<usize> = (0..setting.observations.len()).step_by(step).collect();
    let distance = |a: usize, b: usize| -> f64 {
        let (a, b) = (
            &setting.observations[a].q_rad,
            &setting.observations[b].q_rad,
        );
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let product = |point: &usize| -> Option<f64> {
        // Another target at the same pose, or a repeated pose, shows nothing about the joints' effect.
        let others = points
            .iter()
            .map(|other| (distance(*point, *other), *other))
            .filter(|(d, _)| *d > 1e-6);
        let (_, nearest) = others.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let [here, there] = [*point, nearest].map(|point| position_rows(fit, &residuals, point));
        Some(here.dot(&there))
    };
    let products: Vec<f64> = points.iter().filter_map(product).collect();
    let n = products.len() as f64;
    let mean = products.iter().sum::<f64>() / n;
    let variance = products
        .iter()
        .map(|p| (p - mean) * (p - mean))
        .sum::<f64>()
        / (n - 1.0);
    mean > (variance / n).sqrt()
}

fn samples(
    setting: &Setting<'_>,
    points: &[usize],
    left: impl Fn(usize) -> Vector3<f64>,
) -> Samples {
    let step = points.len().div_ceil(MAX_SAMPLES).max(1);
    let taken: Vec<usize> = points.iter().copied().step_by(step).collect();
    let weight = |point: &usize| setting.observations[*point].weight;
    let mean = taken.iter().map(weight).sum::<f64>() / taken.len() as f64;
    Samples {
        weights: taken.iter().map(|point| weight(point) / mean).collect(),
        poses: taken
            .iter()
            .map(|point| setting.observations[*point].q_rad.clone())
            .collect(),
        left_mm: taken.iter().map(|point| left(*point)).collect(),
    }
}

/// Trains a network on poses and their residuals (base frame, mm). It starts from random weights or, if the robot has a network of the same size,
/// from its weights. `None` without samples.
fn train_residual_network(
    samples: &Samples,
    earlier: Option<&ResidualNetwork>,
    seed: u64,
) -> Option<ResidualNetwork> {
    let n_joints = samples.poses.first()?.len();
    let n = samples.poses.len() as f64;
    let squares = samples.left_mm.iter().zip(&samples.weights);
    let sum: f64 = squares.map(|(left, w)| w * left.norm_squared()).sum();
    let scale_mm = (sum / (3.0 * n)).sqrt().max(f64::MIN_POSITIVE);
    let range = |joint: usize| {
        let values = samples.poses.iter().map(|q| q[joint]);
        values.fold((f64::MAX, f64::MIN), |(low, high), q| {
            (low.min(q), high.max(q))
        })
    };
    let ranges: Vec<(f64, f64)> = (0..n_joints).map(range).collect();
    let mut found = ResidualNetwork {
        centre_rad: ranges
            .iter()
            .map(|(low, high)| 0.5 * (low + high))
            .collect(),
        half_range_rad: ranges
            .iter()
            .map(|(low, high)| (0.5 * (high - low)).max(0.1))
            .collect(),
        hidden_weights: vec![],
        hidden_thresholds: vec![],
        output_weights: vec![],
        output_thresholds: vec![],
        scale_mm,
    };
    let inputs: Vec<Vec<f64>> = samples
        .poses
        .iter()
        .map(|q| {
            (0..n_joints)
                .map(|j| (q[j] - found.centre_rad[j]) / found.half_range_rad[j])
                .collect()
        })
        .collect();
    let targets: Vec<Vec<f64>> = samples
        .left_mm
        .iter()
        .map(|left| (left / scale_mm).as_slice().to_vec())
        .collect();
    let options = bpnn::Options {
        seed,
        n_epochs: EPOCHS,
        weight_decay: 1.0 / (3.0 * n),
        ..bpnn::Options::default()
    };
    let first = earlier
        .and_then(|earlier| remembered(earlier, &found))
        .unwrap_or_else(|| bpnn::initial_network(n_joints, HIDDEN, 3, &options));
    let (network, _) = bpnn::train_from(first, &inputs, &targets, &samples.weights, &options);
    let Network {
        hidden_weights,
        hidden_thresholds,
        output_weights,
        output_thresholds,
        ..
    } = network;
    found = ResidualNetwork {
        hidden_weights,
        hidden_thresholds,
        output_weights,
        output_thresholds,
        ..found
    };
    Some(found)
}

/// Warm start: the weights of an earlier network, converted so that they give the same displacements with the scales of the new network.
fn remembered(earlier: &ResidualNetwork, scales: &ResidualNetwork) -> Option<Network> {
    let n_joints = scales.centre_rad.len();
    if earlier.centre_rad.len() != n_joints || earlier.hidden_thresholds.len() != HIDDEN {
        return None;
    }
    let mut network = Network {
        n_inputs: n_joints,
        n_hidden: HIDDEN,
        n_outputs: 3,
        hidden_weights: earlier.hidden_weights.clone(),
        hidden_thresholds: earlier.hidden_thresholds.clone(),
        output_weights: earlier
            .output_weights
            .iter()
            .map(|w| w * earlier.scale_mm / scales.scale_mm)
            .collect(),
        output_thresholds: earlier
            .output_thresholds
            .iter()
            .map(|t| t * earlier.scale_mm / scales.scale_mm)
            .collect(),
    };
    // w·(q − c)/h − t at the old scales equals w'·(q − c')/h' − t' at the new scales
    for k in 0..HIDDEN {
        for j in 0..n_joints {
            let old = earlier.hidden_weights[k * n_joints + j] / earlier.half_range_rad[j];
            network.hidden_weights[k * n_joints + j] = old * scales.half_range_rad[j];
            network.hidden_thresholds[k] -= old * (scales.centre_rad[j] - earlier.centre_rad[j]);
        }
    }
    Some(network)
}
