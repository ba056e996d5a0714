//! Householder triangularisation of small dense systems, column-major, applied to the right-hand side as well.

use multiversion::multiversion;
use std::ops::Range;

/// Number of partial sums of a dot product. It is fixed, so that the results do not depend on the CPU.
const LANES: usize = 8;

/// Σ a_i b_i, in eight interleaved partial sums.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    dot_of_parts(a, b, std::slice::from_ref(&(0..a.len())))
}

/// As [`dot`], if a is zero outside of some parts, to the last bit. Parts begin at multiples of eight, and end there or with the vector.
#[inline(always)]
fn dot_of_parts(a: &[f64], b: &[f64], parts: &[Range<usize>]) -> f64 {
    let mut sums = [0.0; LANES];
    let mut rest = 0.0;
    for part in parts {
        let (a_blocks, a_rest) = a[part.clone()].as_chunks::<LANES>();
        let (b_blocks, b_rest) = b[part.clone()].as_chunks::<LANES>();
        for (x, y) in a_rest.iter().zip(b_rest) {
            rest = x.mul_add(*y, rest);
        }
        for (x, y) in a_blocks.iter().zip(b_blocks) {
            for lane in 0..LANES {
                sums[lane] = x[lane].mul_add(y[lane], sums[lane]);
            }
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + b) + (c + d)) + ((e + f) + (g + h)) + rest
}

/// y <- y + factor · x
#[inline(always)]
pub(super) fn add_scaled(factor: f64, x: &[f64], y: &mut [f64]) {
    // Blocks of a fixed size are fast even without optimisation, which is how tests run.
    let (x_blocks, x_rest) = x.as_chunks::<LANES>();
    let (y_blocks, y_rest) = y.as_chunks_mut::<LANES>();
    for (x, y) in x_blocks.iter().zip(y_blocks) {
        for lane in 0..LANES {
            y[lane] = factor.mul_add(x[lane], y[lane]);
        }
    }
    for (x, y) in x_rest.iter().zip(y_rest) {
        *y = factor.mul_add(*x, *y);
    }
}

/// The first block of a vector, and the range of blocks from the first to the last other nonzero number. Triangles that are stacked on
/// other rows have many zeros in between.
#[inline(always)]
fn parts_with_numbers(v: &[f64]) -> [Range<usize>; 2] {
    let n = v.len();
    let is_number = |x: &f64| *x != 0.0;
    let head = LANES.min(n);
    let Some(first) = v[head..].iter().position(is_number) else {
        return [0..head, head..head];
    };
    let last = head + v[head..].iter().rposition(is_number).unwrap_or(first);
    let begin = (head + first) / LANES * LANES;
    [0..head, begin..n.min((last / LANES + 1) * LANES)]
}

/// Replaces `tail` by the Householder vector v that maps it to (diagonal, 0, …, 0). Returns the diagonal and 2 / vᵀv, or `None` if the tail is all
/// zero.
#[inline(always)]
pub(super) fn householder(tail: &mut [f64]) -> Option<(f64, f64)> {
    let norm = dot(tail, tail).sqrt();
    if norm == 0.0 {
        return None;
    }
    let diagonal = if tail[0] > 0.0 { -norm } else { norm };
    tail[0] -= diagonal; // no cancellation, because the signs differ
    Some((diagonal, -1.0 / (diagonal * tail[0])))
}

/// Replaces the upper triangle of `matrix` (rows × columns, rows ≥ columns, column-major) by R, and `rhs` by Qᵀ · rhs. The part below the diagonal is
/// not valid afterwards.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2+fma"))]
pub fn triangularise(matrix: &mut [f64], n_rows: usize, rhs: &mut [f64]) {
    let n_columns = matrix.len() / n_rows;
    for k in 0..n_columns {
        let (left, right) = matrix.split_at_mut((k + 1) * n_rows);
        let v = &mut left[k * n_rows + k..];
        let Some((diagonal, scale)) = householder(v) else {
            continue;
        };
        let parts = parts_with_numbers(v);
        let reflect = |column: &mut [f64]| {
            let factor = -scale * dot_of_parts(v, column, &parts);
            for part in &parts {
                add_scaled(factor, &v[part.clone()], &mut column[part.clone()]);
            }
        };
        for column in right.chunks_exact_mut(n_rows) {
            reflect(&mut column[k..]);
        }
        reflect(&mut rhs[k..n_rows]);
        v[0] = diagonal;
    }
}

/// Length of a vector.
pub fn norm(x: &[f64]) -> f64 {
    squares(x).sqrt()
}

/// Sum of squares.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub fn squares(x: &[f64]) -> f64 {
    dot(x, x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twenty rounding errors of numbers of order one.
    const ROUNDING: f64 = 1e-14;

    /// Triangles are stacked on a diagonal and on full rows, so most numbers are zero.
    #[test]
    fn zeros_that_are_left_out_change_no_bit() {
        for p in [1, 2, 7, 8, 9, 20, 41] {
            for full_rows in [0, 3, 8, 30] {
                let n = 2 * p + full_rows;
                let mut matrix = vec![0.0; n * p];
                for (j, column) in matrix.chunks_exact_mut(n).enumerate() {
                    let number = |i: usize| libm::sin((3 * i + 7 * j) as f64);
                    (0..=j).for_each(|i| column[i] = number(i));
                    column[p + j] = 0.3;
                    (2 * p..n).for_each(|i| column[i] = number(i));
                }
                let rhs: Vec<f64> = (0..n).map(|i| libm::cos(5.0 * i as f64)).collect();
                let (mut fast, mut fast_rhs) = (matrix.clone(), rhs.clone());
                triangularise(&mut fast, n, &mut fast_rhs);
                let (mut plain, mut plain_rhs) = (matrix, rhs);
                for k in 0..p {
                    let (left, right) = plain.split_at_mut((k + 1) * n);
                    let v = &mut left[k * n + k..];
                    let (diagonal, scale) = householder(v).unwrap();
                    let mut columns: Vec<&mut [f64]> = right.chunks_exact_mut(n).collect();
                    columns.push(&mut plain_rhs);
                    for column in columns {
                        let factor = -scale * dot(v, &column[k..]);
                        add_scaled(factor, v, &mut column[k..]);
                    }
                    v[0] = diagonal;
                }
                let bits = |of: &[f64]| of.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&fast), bits(&plain), "{p} {full_rows}");
                assert_eq!(bits(&fast_rhs), bits(&plain_rhs), "{p} {full_rows}");
            }
        }
    }

    #[test]
    fn triangularising_keeps_the_normal_equations() {
        // A (4 × 2) and b: RᵀR must be AᵀA, and Rᵀ(Qᵀb) must be Aᵀb.
        let a = [1.0, -2.0, 0.5, 3.0, 0.25, 1.5, -1.0, 2.0];
        let b = [0.3, -0.7, 1.1, 0.9];
        let (mut r, mut qtb) = (a, b);
        triangularise(&mut r, 4, &mut qtb);
        let (r00, r01, r11) = (r[0], r[4], r[5]);
        assert!((r00 * r00 - dot(&a[..4], &a[..4])).abs() < ROUNDING);
        assert!((r00 * r01 - dot(&a[..4], &a[4..])).abs() < ROUNDING);
        assert!((r01 * r01 + r11 * r11 - dot(&a[4..], &a[4..])).abs() < ROUNDING);
        assert!((r00 * qtb[0] - dot(&a[..4], &b)).abs() < ROUNDING);
        assert!((r01 * qtb[0] + r11 * qtb[1] - dot(&a[4..], &b)).abs() < ROUNDING);
    }
}
