//! Orthonormal basis of the column space of a matrix.

use super::qr::{add_scaled, triangularise};
use multiversion::multiversion;
use nalgebra::DMatrix;

/// A matrix with more rows than this is reduced block by block.
pub const MIN_ROWS: usize = 6_000;
/// Number of rows that are reduced at a time: they fit into a processor's cache.
const ROWS_AT_ONCE: usize = 600;
/// Number of passes. The second one makes the columns orthonormal to rounding [Yamamoto 2015, Cholesky QR 2, with Householder's triangle instead of
/// Cholesky's].
const N_PASSES: usize = 2;
/// Singular values below this share of the largest are rounding.
const SINGULAR_SHARE: f64 = 1e-9;
/// Iteration limit of a singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;

/// Q of A = Q·R, rows × columns. For a tall matrix, R is computed from blocks of rows, and Q is A·R⁻¹.
pub fn orthonormal(mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    if matrix.nrows() <= MIN_ROWS || matrix.ncols() == 0 {
        return matrix.qr().q();
    }
    for _ in 0..N_PASSES {
        let r = triangle(&matrix);
        let n_rows = matrix.nrows();
        divide(matrix.as_mut_slice(), n_rows, r.as_slice());
    }
    matrix
}

/// Orthonormal columns that span those of a matrix, whatever their units. Directions with singular values below [`SINGULAR_SHARE`] are left out. `None`
/// if the decomposition fails.
pub fn span(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let mut scaled = matrix.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let svd = scaled.try_svd(true, false, f64::EPSILON, SVD_ITERATIONS)?;
    let largest = svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len())
        .filter(|k| svd.singular_values[*k] > SINGULAR_SHARE * largest)
        .collect();
    Some(svd.u?.select_columns(&kept))
}

/// R of a tall matrix, columns × columns, computed some rows at a time.
pub fn triangle(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let p = matrix.ncols();
    let mut r = DMatrix::zeros(p, p);
    for first in (0..matrix.nrows()).step_by(ROWS_AT_ONCE) {
        let more = ROWS_AT_ONCE.min(matrix.nrows() - first);
        let mut stacked = DMatrix::zeros(p + more, p);
        stacked.rows_mut(0, p).copy_from(&r);
        stacked
            .rows_mut(p, more)
            .copy_from(&matrix.rows(first, more));
        triangularise(stacked.as_mut_slice(), p + more, &mut vec![0.0; p + more]);
        r = stacked.rows(0, p).upper_triangle();
    }
    r
}

/// A <- A·R⁻¹, both column-major. A column becomes zero if the others leave nothing of it.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn divide(a: &mut [f64], n_rows: usize, r: &[f64]) {
    let p = a.len() / n_rows;
    for j in 0..p {
        let (before, from) = a.split_at_mut(j * n_rows);
        let column = &mut from[..n_rows];
        for (i, known) in before.chunks_exact(n_rows).enumerate() {
            add_scaled(-r[j * p + i], known, column);
        }
        let diagonal = r[j * p + j];
        let scale = if diagonal == 0.0 { 0.0 } else { 1.0 / diagonal };
        column.iter_mut().for_each(|v| *v *= scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bound of the rounding errors: some hundred of the method, and those of the test's inner products of `rows` terms, at most one per term [Higham
    /// 2002, eq. 3.5].
    fn rounding(rows: usize) -> f64 {
        (500 + rows) as f64 * f64::EPSILON
    }

    #[test]
    fn a_tall_matrix_gets_orthonormal_columns_that_span_its_own() {
        for rows in [50, MIN_ROWS + 1, 3 * MIN_ROWS + 7] {
            // Columns that are nearly parallel and differ in size by a million.
            let a = DMatrix::from_fn(rows, 9, |i, j| {
                let (x, scale) = (i as f64 / rows as f64, libm::pow(10.0, j as f64 - 4.0));
                scale * (libm::sin(3.0 * x + 0.3 * j as f64) + 0.1 * libm::sin((7 * i + j) as f64))
            });
            let q = orthonormal(a.clone());
            let off = q.tr_mul(&q) - DMatrix::identity(9, 9);
            let rounding = rounding(rows);
            assert!(off.amax() < rounding, "{rows}: {}", off.amax());
            let left = &a - &q * q.tr_mul(&a);
            for j in 0..9 {
                assert!(left.column(j).norm() < rounding * a.column(j).norm());
            }
        }
    }
}
