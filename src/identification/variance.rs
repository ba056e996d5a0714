//! How large the misfit of a model is: σm², where residuals have the variance σ²·I + σm²·Φ·Φᵀ outside of what a fit can follow.
//!
//! The eigenvectors of ΦᵀΦ there split the residuals into independent ones, so that the likelihood of each ratio σm²/σ² is a sum. It is
//! the restricted likelihood [Patterson & Thompson 1971].

use crate::solvers::products::{less_product, transposed_times};
use nalgebra::{DMatrix, DVector};

/// A misfit is kept if its likelihood ratio is above the square of this: the upper 5 % at the boundary (Self & Liang 1987).
const KEPT_ABOVE: f64 = 1.645;
/// Ratios σm²/σ² that are tried, as powers of ten per unit feature of 1 mm: from invisible to all there is.
const LOG10_RATIO: (f64, f64) = (-8.0, 12.0);
/// Points of the grid over them.
const GRID: usize = 81;
/// Golden sections around the best of them: the bracket shrinks by 0.618 each.
const SECTIONS: usize = 40;
/// Features below this share of the largest tell nothing.
const NEGLIGIBLE: f64 = 1e-12;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// The residuals along the eigenvectors of ΦᵀΦ: their squares, the eigenvalues there, and the sum of squares of the rest.
pub struct Spectrum {
    squares: Vec<f64>,
    eigenvalues: Vec<f64>,
    rest: f64,
    n_free: f64,
}

impl Spectrum {
    /// Of residuals and features outside of what a fit can follow, with `n_free` degrees of freedom. `rest` is the sum of squares of further
    /// residuals that do not depend on features.
    pub fn new(
        residuals: &DVector<f64>,
        features: &DMatrix<f64>,
        rest: f64,
        n_free: f64,
    ) -> Option<Self> {
        let eigen = transposed_times(features, features)
            .try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
        let scores = eigen.eigenvectors.tr_mul(&features.tr_mul(residuals));
        let smallest = NEGLIGIBLE * eigen.eigenvalues.max();
        let mut kept: Vec<usize> = (0..scores.len())
            .filter(|k| eigen.eigenvalues[*k] > smallest)
            .collect();
        kept.sort_by(|i, j| {
            eigen.eigenvalues[*j]
                .total_cmp(&eigen.eigenvalues[*i])
                .then(i.cmp(j))
        });
        kept.truncate(n_free.max(0.0) as usize);
        let squares: Vec<f64> = kept
            .iter()
            .map(|k| scores[*k] * scores[*k] / eigen.eigenvalues[*k])
            .collect();
        let along: f64 = squares.iter().sum();
        Some(Self {
            squares,
            eigenvalues: kept.iter().map(|k| eigen.eigenvalues[*k]).collect(),
            rest: rest + (residuals.norm_squared() - along).max(0.0),
            n_free: n_free.max(1.0),
        })
    }

    /// σ² for a ratio σm²/σ².
    fn noise_variance(&self, ratio: f64) -> f64 {
        let along: f64 = self
            .squares
            .iter()
            .zip(&self.eigenvalues)
            .map(|(z, s)| z / (1.0 + ratio * s))
            .sum();
        (along + self.rest) / self.n_free
    }

    /// −2 · log of the restricted likelihood, σ² profiled out, up to a constant.
    fn deviance(&self, ratio: f64) -> f64 {
        let volume: f64 = self
            .eigenvalues
            .iter()
            .map(|s| libm::log1p(ratio * s))
            .sum();
        self.n_free * libm::log(self.noise_variance(ratio).max(f64::MIN_POSITIVE)) + volume
    }

    /// The most probable σm beside noise of standard deviation σ, with a half-Cauchy prior of this scale [Gelman 2006]. It is 0 where white
    /// noise alone would show as much in one of twenty cases.
    pub fn most_probable(&self, usual_std: f64, noise_std: f64) -> f64 {
        let deviance = |ratio: f64| {
            let std = ratio.sqrt() * noise_std / usual_std;
            self.deviance(ratio) + 2.0 * libm::log1p(std * std)
        };
        let ratio = smallest(deviance);
        match deviance(0.0) - deviance(ratio) > KEPT_ABOVE * KEPT_ABOVE {
            true => ratio.sqrt() * noise_std,
            false => 0.0,
        }
    }
}

/// The ratio of smallest deviance: a grid over its logarithm, then golden sections.
fn smallest(deviance: impl Fn(f64) -> f64) -> f64 {
    let at = |log10: f64| deviance(libm::pow(10.0, log10));
    let step = (LOG10_RATIO.1 - LOG10_RATIO.0) / (GRID - 1) as f64;
    let grid = (0..GRID)
        .map(|i| LOG10_RATIO.0 + step * i as f64)
        .map(|log10| (log10, at(log10)));
    let best = grid
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(LOG10_RATIO.0, |(log10, _)| log10);
    let (mut low, mut high) = (best - step, best + step);
    for _ in 0..SECTIONS {
        let third = 0.381_966 * (high - low);
        if at(low + third) < at(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    libm::pow(10.0, 0.5 * (low + high))
}

/// As [`misfit_ratio`], 0 where white noise alone would show as much in one of twenty cases; with 2·log of the likelihoods' ratio.
pub fn kept_ratio(
    residuals: &DVector<f64>,
    basis: &DMatrix<f64>,
    features: &DMatrix<f64>,
) -> Option<(f64, f64)> {
    let n_free = residuals.len() as f64 - basis.ncols() as f64;
    let residuals = residuals - basis * basis.tr_mul(residuals);
    let features = less_product(features, basis, &transposed_times(basis, features));
    let spectrum = Spectrum::new(&residuals, &features, 0.0, n_free)?;
    let ratio = smallest(|ratio| spectrum.deviance(ratio));
    let likelier = spectrum.deviance(0.0) - spectrum.deviance(ratio);
    Some(match likelier > KEPT_ABOVE * KEPT_ABOVE {
        true => (ratio, likelier),
        false => (0.0, likelier.max(0.0)),
    })
}

/// σm²/σ²: how much more than white noise the residuals of a fit follow the features of the misfit. `basis` spans what the fit can
/// change, with orthonormal columns.
pub fn misfit_ratio(
    residuals: &DVector<f64>,
    basis: &DMatrix<f64>,
    features: &DMatrix<f64>,
) -> f64 {
    let n_free = residuals.len() as f64 - basis.ncols() as f64;
    let residuals = residuals - basis * basis.tr_mul(residuals);
    let features = less_product(features, basis, &transposed_times(basis, features));
    Spectrum::new(&residuals, &features, 0.0, n_free)
        .map_or(0.0, |spectrum| smallest(|ratio| spectrum.deviance(ratio)))
}
