//! Uncertainty of the parameters at a minimum.

use super::directions::{SMALLEST_SINGULAR_VALUE, SVD_ITERATIONS_PER_PARAMETER};
use crate::solvers::qr::norm;
use crate::solvers::qr::triangularise;
use nalgebra::DMatrix;

/// Covariance of the parameters, as determined by the residuals.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    /// variance · (JᵀJ)⁺, parameters × parameters. Unobservable directions contribute nothing, although their uncertainty is unbounded: check `rank`.
    pub matrix: DMatrix<f64>,
    /// Number of observable directions.
    pub rank: usize,
}

/// Covariance of the parameters from the Jacobian at the minimum and the variance of one residual, usually Σ r_i² / (residuals − rank). `None` if the
/// Jacobian is not finite, or if the singular value decomposition failed.
///
/// Singular values are those of the Jacobian with its columns scaled to norm one; those below 1e-12 of the largest
/// count as zero.
pub fn covariance(jacobian: &DMatrix<f64>, variance: f64) -> Option<Covariance> {
    let (m, n) = jacobian.shape();
    if !jacobian.iter().all(|value| value.is_finite()) {
        return None;
    }
    let norms = jacobian.column_iter().map(|column| norm(column.as_slice()));
    let inverse: Vec<f64> = norms
        .map(|norm| if norm > 0.0 { 1.0 / norm } else { 0.0 })
        .collect();
    // with fewer residuals than parameters, rows of zeros are added
    let mut scaled = DMatrix::from_fn(m.max(n), n, |i, j| {
        if i < m {
            jacobian[(i, j)] * inverse[j]
        } else {
            0.0
        }
    });
    if n > 0 {
        triangularise(scaled.as_mut_slice(), m.max(n), &mut vec![0.0; m.max(n)]);
    }
    let r = DMatrix::from_fn(n, n, |i, j| if i <= j { scaled[(i, j)] } else { 0.0 });
    let svd = r.try_svd(
        false,
        true,
        f64::EPSILON,
        SVD_ITERATIONS_PER_PARAMETER * n.max(1),
    )?;
    let v_t = svd.v_t?;
    let smallest = SMALLEST_SINGULAR_VALUE * svd.singular_values.max();
    let seen: Vec<usize> = (0..n)
        .filter(|&k| svd.singular_values[k] > smallest)
        .collect();
    let matrix = DMatrix::from_fn(n, n, |i, j| {
        let sum = seen.iter().fold(0.0, |sum: f64, &k| {
            let sigma = svd.singular_values[k];
            (v_t[(k, i)] / sigma).mul_add(v_t[(k, j)] / sigma, sum)
        });
        variance * sum * inverse[i] * inverse[j]
    });
    Some(Covariance {
        matrix,
        rank: seen.len(),
    })
}
