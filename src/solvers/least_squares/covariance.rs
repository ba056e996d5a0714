//! Uncertainty of the parameters at a minimum.

use super::column_norms;
use super::directions::{SMALLEST_SINGULAR_VALUE, SVD_ITERATIONS_PER_PARAMETER, reduce};
use nalgebra::DMatrix;

/// What the residuals say about the parameters' uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    /// variance · (JᵀJ)⁺, parameters × parameters. Directions that the residuals cannot see contribute nothing, though
    /// their uncertainty is unbounded: look at `rank`.
    pub matrix: DMatrix<f64>,
    /// Number of directions that the residuals can see.
    pub rank: usize,
}

/// Covariance of the parameters from the Jacobian at the minimum, and the variance of one residual, usually
/// Σ r_i² / (residuals − rank). `None` where the Jacobian is not finite or its singular values were not found.
///
/// Singular values are those of the Jacobian with its columns scaled to norm one; those below 1e-12 of the largest
/// count as zero.
pub fn covariance(jacobian: &DMatrix<f64>, variance: f64) -> Option<Covariance> {
    let (m, n) = jacobian.shape();
    if !jacobian.iter().all(|value| value.is_finite()) {
        return None;
    }
    let inverse: Vec<f64> = column_norms(jacobian).map(|norm| if norm > 0.0 { 1.0 / norm } else { 0.0 }).collect();
    let scaled = DMatrix::from_fn(m, n, |i, j| jacobian[(i, j)] * inverse[j]);
    let (r, _) = reduce(&scaled, &vec![0.0; m]);
    let svd = DMatrix::from_vec(n, n, r).try_svd(false, true, f64::EPSILON, SVD_ITERATIONS_PER_PARAMETER * n.max(1))?;
    let v_t = svd.v_t?;
    let smallest = SMALLEST_SINGULAR_VALUE * svd.singular_values.max();
    let seen: Vec<usize> = (0..n).filter(|&k| svd.singular_values[k] > smallest).collect();
    let matrix = DMatrix::from_fn(n, n, |i, j| {
        let sum = seen.iter().fold(0.0, |sum: f64, &k| {
            let sigma = svd.singular_values[k];
            (v_t[(k, i)] / sigma).mul_add(v_t[(k, j)] / sigma, sum)
        });
        variance * sum * inverse[i] * inverse[j]
    });
    Some(Covariance { matrix, rank: seen.len() })
}
