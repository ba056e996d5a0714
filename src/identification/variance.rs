//! What the errors of weighted residuals are made of: V = σe²·(I + ρ·B) + σm²·Φ·Φᵀ, as in [`uncertainty`](super::uncertainty).
//!
//! ρ is found by moments, σm by restricted maximum likelihood (Patterson & Thompson 1971).

use crate::identification::distributions::chi_square_tail;
use crate::identification::shared::Shared;
use crate::solvers::products::{less_product, transposed_times};
use nalgebra::{DMatrix, DVector};

/// A part of V is kept if its test is above this: the upper 5 % of a standard normal variable; its square is the upper 5 % of a
/// likelihood ratio at the boundary (Self & Liang 1987).
const KEPT_ABOVE: f64 = 1.645;
/// Ratios σm²/σe² that are tried, as powers of ten per unit feature of 1 mm: from invisible to all there is.
const LOG10_RATIO: (f64, f64) = (-8.0, 12.0);
/// Points of the grid over them, and golden sections around its best.
const GRID: usize = 81;
/// Golden sections: the bracket shrinks by 0.618 each.
const SECTIONS: usize = 40;
/// A misfit is believed unless its residuals would be as small as those there are in fewer than one of twenty cases: so sure is one also that
/// there is one ([`KEPT_ABOVE`]).
const TOO_SMALL: f64 = 0.05;
/// Features below this share of the largest tell nothing.
const NEGLIGIBLE: f64 = 1e-12;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// The linear problem behind a fit: residuals and derivatives along the seen combinations, weighted.
pub(super) struct Linear {
    pub y: DVector<f64>,
    /// 3·N × r.
    pub a: DMatrix<f64>,
    /// 3·N × m.
    pub features: DMatrix<f64>,
    pub shared: Shared,
}

/// What the columns of `m` leave outside the span of the orthonormal columns of `q`.
fn outside(q: &DMatrix<f64>, m: &DMatrix<f64>) -> DMatrix<f64> {
    less_product(m, q, &transposed_times(q, m))
}

/// ρ by moments: with P the projection out of the span of A, E[yᵀPBPy] = σe²·(tr PB + ρ·tr PBPB) and
/// E[yᵀPy] = σe²·(tr P + ρ·tr PB). ZᵀPZ = L − WᵀW, with L the squared lengths of Z's columns and W = QᵀZ, is never written out.
pub(super) fn shared_ratio(linear: &Linear) -> Option<f64> {
    if linear.shared.ncols() == 0 {
        return Some(0.0);
    }
    let q = linear.a.clone().qr().q();
    let w = linear.shared.transpose_times(&q).transpose();
    let lengths = linear.shared.squared_lengths();
    let y = outside(
        &q,
        &DMatrix::from_column_slice(linear.y.len(), 1, linear.y.as_slice()),
    );
    let n_free = (linear.a.nrows() - linear.a.ncols()) as f64;
    let trace = lengths.iter().sum::<f64>() - w.norm_squared();
    let crossed: f64 = lengths
        .iter()
        .zip(w.column_iter())
        .map(|(l, w)| l * (l - 2.0 * w.norm_squared()))
        .sum();
    let trace_of_square = crossed + (&w * w.transpose()).norm_squared();
    let whole = y.norm_squared();
    if whole <= 0.0 {
        return Some(0.0);
    }
    let ratio = linear.shared.transpose_times(&y).norm_squared() / whole * n_free;
    let spread = (2.0 * (trace_of_square - trace * trace / n_free))
        .max(0.0)
        .sqrt();
    if ratio - trace <= KEPT_ABOVE * spread {
        return Some(0.0);
    }
    let below = trace_of_square - ratio * trace / n_free;
    (below > 0.0)
        .then(|| (ratio - trace) / below)
        .or(Some(MOST_SHARED))
}

/// Degrees of freedom of the noise. Where configurations share errors these are known from the configurations' means (the mean square
/// between groups of an analysis of variance): tr P·Z·(ZᵀZ)⁻¹·Zᵀ.
pub(super) fn freedom(linear: &Linear, ratio: f64) -> f64 {
    let n_free = (linear.a.nrows() - linear.a.ncols()) as f64;
    if ratio == 0.0 {
        return n_free;
    }
    let w = linear.shared.transpose_times(&linear.a.clone().qr().q());
    let lengths = linear.shared.squared_lengths();
    let between: f64 = lengths
        .iter()
        .zip(w.row_iter())
        .map(|(l, w)| 1.0 - w.norm_squared() / l)
        .sum();
    between.clamp(1.0, n_free)
}

/// ρ where nothing but what a configuration shares can be seen.
const MOST_SHARED: f64 = 1e6;

/// The problem with (I + ρ·B)^(-1/2) from the left. Z's columns are orthogonal: along each, of squared length l, the factor is
/// 1/sqrt(1 + ρ·l).
pub(super) fn whitened(linear: Linear, ratio: f64) -> Linear {
    if ratio == 0.0 {
        return linear;
    }
    let lengths = linear.shared.squared_lengths();
    let shrink = |m: &DMatrix<f64>| {
        let mut along = linear.shared.transpose_times(m);
        for (mut row, l) in along.row_iter_mut().zip(&lengths) {
            row *= (1.0 - 1.0 / (1.0 + ratio * l).sqrt()) / l;
        }
        m - linear.shared.times(&along)
    };
    let (a, features) = (shrink(&linear.a), shrink(&linear.features));
    let y = shrink(&DMatrix::from_column_slice(
        linear.y.len(),
        1,
        linear.y.as_slice(),
    ))
    .column(0)
    .into();
    Linear {
        y,
        a,
        features,
        shared: linear.shared,
    }
}

/// σe², σm² and how well they are known.
pub(super) struct Components {
    pub noise_variance: f64,
    pub misfit_variance: f64,
    pub variance_of_variances: [[f64; 2]; 2],
    /// Where the misfit's variance is not determined.
    pub undetermined: Option<UndeterminedMisfit>,
}

/// A misfit whose size the residuals do not determine. Its likelihood is largest where it explains small residuals that the fit can hardly
/// follow, and the large ones that it would leave elsewhere are not there: what the model cannot say is of another kind than its features.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UndeterminedMisfit {
    /// Length of the residuals that it would leave, root mean square over the points, mm.
    pub predicted_mm: f64,
    /// And of those that there are, mm.
    pub found_mm: f64,
}

/// The residuals along the eigenvectors of P·Φ·Φᵀ·P: their squares, the eigenvalues there, and the rest.
struct Spectrum {
    squares: Vec<f64>,
    eigenvalues: Vec<f64>,
    rest: f64,
    n_free: f64,
}

impl Spectrum {
    /// σe² for a ratio λ = σm²/σe².
    fn noise_variance(&self, ratio: f64) -> f64 {
        let along: f64 = self
            .squares
            .iter()
            .zip(&self.eigenvalues)
            .map(|(z, s)| z / (1.0 + ratio * s))
            .sum();
        (along + self.rest) / self.n_free
    }

    /// −2 · log of the restricted likelihood, σe² profiled out, up to a constant.
    fn deviance(&self, ratio: f64) -> f64 {
        let volume: f64 = self
            .eigenvalues
            .iter()
            .map(|s| libm::log1p(ratio * s))
            .sum();
        self.n_free * libm::log(self.noise_variance(ratio).max(f64::MIN_POSITIVE)) + volume
    }

    /// The ratio of smallest deviance: a grid over its logarithm, then golden sections.
    fn best_ratio(&self) -> f64 {
        let at = |log10: f64| self.deviance(libm::pow(10.0, log10));
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

    /// Whether components of variance hold for the residuals as a whole: their sum of squares is Σ (σe² + σm²·s)·χ², for which chi-square
    /// with the degrees of freedom of Satterthwaite (1946) stands. `n_points` are those of the residuals.
    fn undetermined(&self, noise: f64, ratio: f64, n_points: f64) -> Option<UndeterminedMisfit> {
        let without = (self.n_free - self.eigenvalues.len() as f64).max(0.0);
        let (mut expected, mut squares) = (without * noise, without * noise * noise);
        for s in &self.eigenvalues {
            let variance = noise * (1.0 + ratio * s);
            (expected, squares) = (expected + variance, squares + variance * variance);
        }
        let found = self.squares.iter().sum::<f64>() + self.rest;
        let freedom = expected * expected / squares;
        let is_too_small = 1.0 - chi_square_tail(freedom * found / expected, freedom) < TOO_SMALL;
        let step = (LOG10_RATIO.1 - LOG10_RATIO.0) / (GRID - 1) as f64;
        let is_at_bound = ratio > libm::pow(10.0, LOG10_RATIO.1 - step);
        (is_too_small || is_at_bound).then(|| UndeterminedMisfit {
            predicted_mm: (expected / n_points).sqrt(),
            found_mm: (found / n_points).sqrt(),
        })
    }

    /// Inverse of the Fisher information of (σe², σm²).
    fn variance_of_variances(&self, noise: f64, misfit: f64) -> [[f64; 2]; 2] {
        let rest = self.n_free - self.eigenvalues.len() as f64;
        let (mut ee, mut em, mut mm) = (rest.max(0.0) / (noise * noise), 0.0, 0.0);
        for s in &self.eigenvalues {
            let weight = 1.0 / ((noise + misfit * s) * (noise + misfit * s));
            (ee, em, mm) = (ee + weight, em + s * weight, mm + s * s * weight);
        }
        if misfit == 0.0 {
            return [[2.0 / ee, 0.0], [0.0, 0.0]];
        }
        let determinant = (ee * mm - em * em).max(f64::MIN_POSITIVE);
        [
            [2.0 * mm / determinant, -2.0 * em / determinant],
            [-2.0 * em / determinant, 2.0 * ee / determinant],
        ]
    }
}

pub(super) fn misfit_components(linear: &Linear, n_free: f64) -> Option<Components> {
    let spectrum = spectrum(linear, n_free)?;
    let white = |noise_variance: f64| Components {
        noise_variance,
        misfit_variance: 0.0,
        variance_of_variances: spectrum.variance_of_variances(noise_variance, 0.0),
        undetermined: None,
    };
    let alone = spectrum.noise_variance(0.0);
    if alone <= 0.0 {
        return Some(Components {
            noise_variance: 0.0,
            misfit_variance: 0.0,
            variance_of_variances: [[0.0; 2]; 2],
            undetermined: None,
        });
    }
    let ratio = spectrum.best_ratio();
    if spectrum.deviance(0.0) - spectrum.deviance(ratio) <= KEPT_ABOVE * KEPT_ABOVE {
        return Some(white(alone));
    }
    let noise_variance = spectrum.noise_variance(ratio);
    let misfit_variance = ratio * noise_variance;
    let variance_of_variances = spectrum.variance_of_variances(noise_variance, misfit_variance);
    let n_points = linear.y.len() as f64 / 3.0;
    Some(Components {
        noise_variance,
        misfit_variance,
        variance_of_variances,
        undetermined: spectrum.undetermined(noise_variance, ratio, n_points),
    })
}

fn spectrum(linear: &Linear, n_free: f64) -> Option<Spectrum> {
    spectrum_outside(
        &linear.y,
        &linear.a.clone().qr().q(),
        &linear.features,
        n_free,
    )
}

fn spectrum_outside(
    y: &DVector<f64>,
    q: &DMatrix<f64>,
    features: &DMatrix<f64>,
    n_free: f64,
) -> Option<Spectrum> {
    let y = y - q * q.tr_mul(y);
    let features = outside(q, features);
    let eigen = transposed_times(&features, &features)
        .try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
    let scores = eigen.eigenvectors.tr_mul(&features.tr_mul(&y));
    let smallest = NEGLIGIBLE * eigen.eigenvalues.max();
    let mut kept: Vec<usize> = (0..scores.len())
        .filter(|k| eigen.eigenvalues[*k] > smallest)
        .collect();
    kept.sort_by(|i, j| {
        eigen.eigenvalues[*j]
            .total_cmp(&eigen.eigenvalues[*i])
            .then(i.cmp(j))
    });
    kept.truncate(n_free as usize);
    let squares: Vec<f64> = kept
        .iter()
        .map(|k| scores[*k] * scores[*k] / eigen.eigenvalues[*k])
        .collect();
    let rest = (y.norm_squared() - squares.iter().sum::<f64>()).max(0.0);
    Some(Spectrum {
        squares,
        eigenvalues: kept.iter().map(|k| eigen.eigenvalues[*k]).collect(),
        rest,
        n_free,
    })
}

/// σm²/σe² by restricted maximum likelihood: how much more than white noise the residuals of a fit follow the features of the misfit.
/// `basis` spans what the fit can change, with orthonormal columns.
pub fn misfit_ratio(
    residuals: &DVector<f64>,
    basis: &DMatrix<f64>,
    features: &DMatrix<f64>,
) -> f64 {
    let n_free = residuals.len() as f64 - basis.ncols() as f64;
    spectrum_outside(residuals, basis, features, n_free)
        .map_or(0.0, |spectrum| spectrum.best_ratio())
}
