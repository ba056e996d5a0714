//! Products of dense matrices with the widest instructions of the CPU; the results are the same on all CPUs, to the last bit.

use super::qr::{add_scaled, dot};
use multiversion::multiversion;
use nalgebra::DMatrix;

/// Number of rows of a factor that are used together. With a hundred columns, they fit into a processor's cache.
const ROWS_AT_ONCE: usize = 480;

/// Aᵀ·B.
pub fn transposed_times(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(a.ncols(), b.ncols());
    if a.nrows() > 0 && a.ncols() > 0 {
        dots(
            a.as_slice(),
            b.as_slice(),
            a.nrows(),
            product.as_mut_slice(),
        );
    }
    product
}

/// C − A·B.
pub fn less_product(c: &DMatrix<f64>, a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut rest = c.clone();
    if a.nrows() > 0 && a.ncols() > 0 {
        subtract(a.as_slice(), b.as_slice(), a.nrows(), rest.as_mut_slice());
    }
    rest
}

/// The columns of some matrices with the same number of rows.
pub fn side_by_side(matrices: &[&DMatrix<f64>]) -> DMatrix<f64> {
    let n_columns = matrices.iter().map(|m| m.ncols()).sum();
    let mut all = DMatrix::zeros(matrices[0].nrows(), n_columns);
    let mut first = 0;
    for m in matrices {
        all.columns_mut(first, m.ncols()).copy_from(m);
        first += m.ncols();
    }
    all
}

/// `square` <- `square` + weight·Σ xᵀ·x over some rows x, lower triangle only. `square` is n × n, row-major; `rows` has one row after another.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub fn add_weighted_square(weight: f64, rows: &[f64], n: usize, square: &mut [f64]) {
    for x in rows.chunks_exact(n) {
        for (i, sums) in square.chunks_exact_mut(n).enumerate() {
            add_scaled(weight * x[i], &x[..=i], &mut sums[..=i]);
        }
    }
}

/// `out` <- Aᵀ·B, all column-major: A is rows × m, B rows × n, `out` m × n.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn dots(a: &[f64], b: &[f64], n_rows: usize, out: &mut [f64]) {
    let m = a.len() / n_rows;
    for first in (0..n_rows).step_by(ROWS_AT_ONCE) {
        let rows = first..n_rows.min(first + ROWS_AT_ONCE);
        for (b, out) in b.chunks_exact(n_rows).zip(out.chunks_exact_mut(m)) {
            for (a, out) in a.chunks_exact(n_rows).zip(out) {
                *out += dot(&a[rows.clone()], &b[rows.clone()]);
            }
        }
    }
}

/// `out` <- `out` − A·B, all column-major: A is rows × m, B m × n, `out` rows × n.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn subtract(a: &[f64], b: &[f64], n_rows: usize, out: &mut [f64]) {
    let m = a.len() / n_rows;
    for first in (0..n_rows).step_by(ROWS_AT_ONCE) {
        let rows = first..n_rows.min(first + ROWS_AT_ONCE);
        for (b, out) in b.chunks_exact(m).zip(out.chunks_exact_mut(n_rows)) {
            for (a, b) in a.chunks_exact(n_rows).zip(b) {
                add_scaled(-b, &a[rows.clone()], &mut out[rows.clone()]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weighted_square_is_that_of_the_weighted_rows() {
        for (rows, n) in [(0, 3), (1, 1), (3, 41), (9, 20)] {
            let a = DMatrix::from_fn(n, rows, |i, j| libm::sin((3 * i + 7 * j) as f64));
            let mut square = vec![0.0; n * n];
            add_weighted_square(0.7, a.as_slice(), n, &mut square);
            let expected = &a * a.transpose() * 0.7;
            for i in 0..n {
                for j in 0..=i {
                    assert!(
                        (square[n * i + j] - expected[(i, j)]).abs() < 1e-14 * (rows + 1) as f64
                    );
                }
            }
        }
    }

    #[test]
    fn products_are_those_of_nalgebra_but_for_rounding() {
        for (rows, m, n) in [
            (1, 1, 1),
            (7, 3, 2),
            (301, 75, 20),
            (1501, 9, 4),
            (0, 2, 3),
            (3, 0, 2),
        ] {
            let numbers = |rows: usize, columns: usize, k: f64| {
                DMatrix::from_fn(rows, columns, |i, j| libm::sin(k + (3 * i + 7 * j) as f64))
            };
            let (a, b, w) = (
                numbers(rows, m, 0.1),
                numbers(rows, n, 0.2),
                numbers(m, n, 0.3),
            );
            let rounding = 1e-15 * (rows + m + 1) as f64;
            assert!(
                (transposed_times(&a, &b) - a.tr_mul(&b))
                    .iter()
                    .all(|v| v.abs() < rounding)
            );
            assert!(
                (less_product(&b, &a, &w) - (&b - &a * &w))
                    .iter()
                    .all(|v| v.abs() < rounding)
            );
        }
    }
}
