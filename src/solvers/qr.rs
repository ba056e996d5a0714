//! Householder triangularisation of small dense systems, column-major, applied to the right-hand side as well.

use multiversion::multiversion;

/// Number of partial sums of a dot product. It is fixed, so that the results do not depend on the CPU.
const LANES: usize = 8;

/// Σ a_i b_i, in eight interleaved partial sums.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (a_blocks, b_blocks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let mut rest = 0.0;
    for (x, y) in a_blocks.remainder().iter().zip(b_blocks.remainder()) {
        rest = x.mul_add(*y, rest);
    }
    for (x, y) in a_blocks.zip(b_blocks) {
        for lane in 0..LANES {
            sums[lane] = x[lane].mul_add(y[lane], sums[lane]);
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + b) + (c + d)) + ((e + f) + (g + h)) + rest
}

/// y <- y + factor · x
#[inline(always)]
pub(super) fn add_scaled(factor: f64, x: &[f64], y: &mut [f64]) {
    for (x, y) in x.iter().zip(y) {
        *y = factor.mul_add(*x, *y);
    }
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
    tail[0] -= diagonal; // never a cancellation: the signs differ
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
        for column in right.chunks_exact_mut(n_rows) {
            let factor = -scale * dot(v, &column[k..]);
            add_scaled(factor, v, &mut column[k..]);
        }
        let factor = -scale * dot(v, &rhs[k..n_rows]);
        add_scaled(factor, v, &mut rhs[k..n_rows]);
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
