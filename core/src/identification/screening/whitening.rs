//! The linear problem at a fit with correlated errors, because a robot's errors are a smooth function of its joints.

use crate::identification::screening::outliers::{ExpectedErrors, Linearised};
use crate::identification::screening::row_order::design_effect;
use crate::identification::statistics::variance::misfit_ratio;
use crate::solvers::orthonormal::orthonormal;
use crate::solvers::products::{less_product, transposed_times};
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector};

/// Features with eigenvalues below this share of the largest carry no information.
const NEGLIGIBLE: f64 = 1e-12;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// V^(-1/2) for V = I + λ·Φ·Φᵀ.
pub struct Whitener {
    /// U of Φ·Φᵀ = U·S·Uᵀ.
    u: DMatrix<f64>,
    /// λS.
    share: Vec<f64>,
}

impl Whitener {
    /// Φ·Φᵀ = U·S·Uᵀ, so that V⁻¹ = I − U·(λS/(1 + λS))·Uᵀ and V^(-1/2) = I − U·(1 − (1 + λS)^(-1/2))·Uᵀ.
    pub fn new(features: &DMatrix<f64>, ratio: f64) -> Option<Self> {
        let eigen = transposed_times(features, features)
            .try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
        let smallest = NEGLIGIBLE * eigen.eigenvalues.max();
        let kept: Vec<usize> = (0..features.ncols())
            .filter(|k| eigen.eigenvalues[*k] > smallest)
            .collect();
        let none = DMatrix::zeros(features.nrows(), kept.len());
        let mut u = -less_product(&none, features, &eigen.eigenvectors.select_columns(&kept));
        u.column_iter_mut()
            .zip(&kept)
            .for_each(|(mut column, k)| column /= eigen.eigenvalues[*k].sqrt());
        Some(Self {
            u,
            share: kept.iter().map(|k| ratio * eigen.eigenvalues[*k]).collect(),
        })
    }

    /// The errors that V contains in addition to the noise.
    pub fn expected(&self) -> ExpectedErrors<'_> {
        ExpectedErrors {
            directions: &self.u,
            variances: &self.share,
        }
    }

    /// V^(-1/2)·M.
    pub fn whitened(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let mut along = transposed_times(&self.u, m);
        along
            .row_iter_mut()
            .zip(&self.share)
            .for_each(|(mut row, s)| row *= 1.0 - 1.0 / (1.0 + s).sqrt());
        less_product(m, &self.u, &along)
    }

    /// V^(-1/2)·v.
    pub fn whitened_column(&self, v: &DVector<f64>) -> DVector<f64> {
        self.whitened(&DMatrix::from_column_slice(v.len(), 1, v.as_slice()))
            .column(0)
            .into_owned()
    }
}

/// The linear problem at a fit, multiplied from the left by V^(-1/2), with V = I + λ·Φ·Φᵀ.
pub struct Whitened {
    /// V^(-1/2)·y, projected out of the changes that parameters can make; 3·N.
    pub residuals: DVector<f64>,
    /// V^(-1/2) times these residuals: its product with Bᵀ is the score of a change B.
    pub scores: DVector<f64>,
    /// E, with BᵀB − BᵀE·EᵀB the normal matrix of the part of B that parameters and V leave.
    pub basis: DMatrix<f64>,
    /// Orthonormal basis of V^(-1/2) times the changes that parameters can make; 3·N × r.
    followed: DMatrix<f64>,
    /// Number of fitted combinations.
    pub n_fitted: usize,
}

impl Whitened {
    /// `features` are those of the same points, in the same order.
    pub fn new(linear: &Linearised, features: &DMatrix<f64>, watch: &Watch<'_>) -> Self {
        let whitened = || {
            let ratio = misfit_ratio(&linear.residuals, &linear.basis, features);
            Self::with_ratio(linear, features, ratio, watch)
        };
        let whitened = watch.goes_on().then(whitened).flatten();
        whitened.unwrap_or_else(|| Self {
            residuals: linear.residuals.clone(),
            scores: linear.residuals.clone(),
            basis: linear.basis.clone(),
            followed: linear.basis.clone(),
            n_fitted: linear.basis.ncols(),
        })
    }

    /// With a given ratio λ. `None` if the decomposition fails, or when the watch stops.
    pub fn with_ratio(
        linear: &Linearised,
        features: &DMatrix<f64>,
        ratio: f64,
        watch: &Watch<'_>,
    ) -> Option<Self> {
        let go_on = || watch.goes_on().then_some(());
        go_on()?;
        let whitener = Whitener::new(features, ratio)?;
        go_on()?;
        let q = orthonormal(whitener.whitened(&linear.basis));
        go_on()?;
        let y = whitener.whitened_column(&linear.residuals);
        let residuals = &y - &q * q.tr_mul(&y);
        let (n_fitted, n_kept) = (q.ncols(), whitener.share.len());
        let mut basis = DMatrix::zeros(q.nrows(), n_fitted + n_kept);
        basis
            .columns_mut(0, n_fitted)
            .copy_from(&whitener.whitened(&q));
        for (k, s) in whitener.share.iter().enumerate() {
            basis.set_column(
                n_fitted + k,
                &(whitener.u.column(k) * (s / (1.0 + s)).sqrt()),
            );
        }
        let scores = whitener.whitened_column(&residuals);
        Some(Self {
            residuals,
            scores,
            basis,
            followed: q,
            n_fitted,
        })
    }

    /// Design effect of the residuals.
    pub fn design_effect(&self, clusters: impl Iterator<Item = usize>) -> f64 {
        design_effect(&self.residuals, &self.followed, clusters)
    }

    /// Reduction of the weighted sum of squares if some columns are fitted as well, with their coefficients and the inverse of their normal matrix.
    /// `None` if the fitted parameters leave nothing of these columns.
    pub fn fitted(&self, columns: &DMatrix<f64>) -> Option<Gain> {
        let along = transposed_times(&self.basis, columns);
        let square = transposed_times(columns, columns) - along.tr_mul(&along);
        let score = columns.tr_mul(&self.scores);
        let factor = square.cholesky()?;
        let coefficients = factor.solve(&score);
        Some(Gain {
            gain: coefficients.dot(&score),
            inverse: factor.inverse(),
            coefficients,
        })
    }
}

/// Gain by further columns.
pub struct Gain {
    /// Reduction of the sum of squares, mm².
    pub gain: f64,
    /// Coefficients of the columns.
    pub coefficients: DVector<f64>,
    /// Their covariance for σ = 1.
    pub inverse: DMatrix<f64>,
}
