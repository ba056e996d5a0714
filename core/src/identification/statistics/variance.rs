//! Estimates the size of a model's misfit σm². The residuals have the variance σ²·I + σm²·Φ·Φᵀ outside the space that a fit can follow.
//!
//! The eigenvectors of ΦᵀΦ in that space split the residuals into independent parts, so that the likelihood of each ratio σm²/σ² is a sum. It is the
//! restricted likelihood (REML) [Patterson & Thompson 1971]. Also the size of noise of which a part is stated.

use crate::identification::statistics::distributions::chi_square_tail;
use crate::solvers::products::{less_product, transposed_times};
use nalgebra::{DMatrix, DVector};

/// Smallest variance, as a share of the usual one. At this level, residuals are rounding errors.
const MIN_VARIANCE: f64 = 1e-18;
/// Number of bisections in the search for a variance.
const HALVINGS: usize = 200;

/// A misfit is kept if its likelihood ratio statistic exceeds the square of this: the upper 5 % at the boundary (Self & Liang 1987).
const KEPT_ABOVE: f64 = 1.645;
/// Range of the ratios σm²/σ² that are tried, as powers of ten per unit feature of 1 mm: from invisible to dominant.
const LOG10_RATIO: (f64, f64) = (-8.0, 12.0);
/// Number of grid points over this range.
const GRID: usize = 81;
/// Number of golden-section steps around the best grid point; each shrinks the bracket by 0.618.
const SECTIONS: usize = 40;
/// Features with eigenvalues below this share of the largest carry no information.
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
    /// Spectrum of residuals and features outside the space that a fit can follow, with `n_free` degrees of freedom. `rest` is the sum of squares of
    /// further residuals that do not depend on features.
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

    /// Spectrum of all residuals of a fit. `basis` spans the changes that the fit can make, with orthonormal columns.
    fn beyond(
        residuals: &DVector<f64>,
        basis: &DMatrix<f64>,
        features: &DMatrix<f64>,
    ) -> Option<Self> {
        let n_free = residuals.len() as f64 - basis.ncols() as f64;
        let residuals = residuals - basis * basis.tr_mul(residuals);
        let features = less_product(features, basis, &transposed_times(basis, features));
        Self::new(&residuals, &features, 0.0, n_free)
    }

    /// Estimate of σ² for a given ratio σm²/σ².
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

    /// The most probable σm for noise of standard deviation σ, with a half-Cauchy prior of scale `usual_std` [Gelman 2006]. It is 0 if its likelihood
    /// ratio statistic is below the square of `kept_above`, a quantile of the normal distribution (Self & Liang 1987).
    pub fn most_probable(&self, usual_std: f64, noise_std: f64, kept_above: f64) -> f64 {
        let deviance = |ratio: f64| {
            let std = ratio.sqrt() * noise_std / usual_std;
            self.deviance(ratio) + 2.0 * libm::log1p(std * std)
        };
        let ratio = minimise(deviance);
        match deviance(0.0) - deviance(ratio) > kept_above * kept_above {
            true => ratio.sqrt() * noise_std,
            false => 0.0,
        }
    }
}

/// The ratio with the smallest deviance: a grid over its logarithm, then golden-section search.
fn minimise(deviance: impl Fn(f64) -> f64) -> f64 {
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

/// σm²/σ²: variance of the residuals of a fit along the features of the misfit, relative to white noise. `basis` spans the changes that the fit can
/// make, with orthonormal columns.
pub fn misfit_ratio(
    residuals: &DVector<f64>,
    basis: &DMatrix<f64>,
    features: &DMatrix<f64>,
) -> f64 {
    Spectrum::beyond(residuals, basis, features)
        .map_or(0.0, |spectrum| minimise(|ratio| spectrum.deviance(ratio)))
}

/// A random effect in the residuals of a fit, compared with the fit without it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomEffect {
    /// Most likely ratio of its variance to that of the noise.
    pub ratio: f64,
    /// 2·log of the likelihood's ratio, with the effect and without it.
    pub likelihood_ratio: f64,
    /// Variance of the noise if the effect is included.
    pub noise_variance: f64,
}

impl RandomEffect {
    /// The ratio; 0 if it is not significant at the 5 % level.
    pub fn kept_ratio(&self) -> f64 {
        match self.likelihood_ratio > KEPT_ABOVE * KEPT_ABOVE {
            true => self.ratio,
            false => 0.0,
        }
    }

    /// Probability that noise alone gives as large a likelihood ratio. Without an effect, a variance is at its bound [Self & Liang 1987].
    pub fn by_chance(&self) -> f64 {
        0.5 * chi_square_tail(self.likelihood_ratio, 1.0)
    }
}

/// The random effect with the given features, one of standard deviation 1 each.
pub fn random_effect(
    residuals: &DVector<f64>,
    basis: &DMatrix<f64>,
    features: &DMatrix<f64>,
) -> Option<RandomEffect> {
    let spectrum = Spectrum::beyond(residuals, basis, features)?;
    let ratio = minimise(|ratio| spectrum.deviance(ratio));
    Some(RandomEffect {
        ratio,
        likelihood_ratio: (spectrum.deviance(0.0) - spectrum.deviance(ratio)).max(0.0),
        noise_variance: spectrum.noise_variance(ratio),
    })
}

/// The factor c² for which Σ square/(stated² + c²·usual²) equals `freedom`, limited to 1e-18 (below, residuals are rounding) and 1e18.
/// Terms are (square, stated², usual²).
pub fn variance_over_usual(terms: &[(f64, f64, f64)], freedom: f64) -> f64 {
    if terms.iter().all(|(_, stated, _)| *stated == 0.0) {
        let sum: f64 = terms.iter().map(|(square, _, usual)| square / usual).sum();
        return (sum / freedom.max(1.0)).max(MIN_VARIANCE);
    }
    bisected(terms, |_| freedom.max(1.0))
}

/// As [`variance_over_usual`], but the most probable c² with a prior: log c is normal about 0 with a standard deviation τ of one decade.
/// The prior adds log c/τ², the derivative of its logarithm, to the freedom, so it matters only if the rows leave hardly any freedom.
pub fn probable_variance_over_usual(terms: &[(f64, f64, f64)], freedom: f64) -> f64 {
    let decade = std::f64::consts::LN_10;
    bisected(terms, |c2| {
        freedom + 0.5 * libm::log(c2) / (decade * decade)
    })
}

/// The c² for which Σ square/(stated² + c²·usual²) equals `freedom(c²)`.
fn bisected(terms: &[(f64, f64, f64)], freedom: impl Fn(f64) -> f64) -> f64 {
    let is_below = |c2: f64| -> bool {
        let term = |(square, stated, usual): &(f64, f64, f64)| square / (stated + c2 * usual);
        terms.iter().map(term).sum::<f64>() > freedom(c2)
    };
    let (mut low, mut high) = (MIN_VARIANCE, 1.0 / MIN_VARIANCE);
    if !is_below(low) {
        return low;
    }
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        match is_below(middle) {
            true => low = middle,
            false => high = middle,
        }
    }
    high
}
