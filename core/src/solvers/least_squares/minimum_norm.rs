//! The shortest minimiser of ‖T·w + b‖ if the rank of T is clear: some combinations of its columns (possibly none) vanish to rounding, and all others
//! are far from zero. If the rank is not clear, singular values have to decide.

use super::directions::SMALLEST_SINGULAR_VALUE;
use crate::solvers::qr::{add_scaled, dot, householder};
use multiversion::multiversion;

/// Columns are kept above this multiple of [`SMALLEST_SINGULAR_VALUE`] of the largest column, and left out below that share divided by this factor.
const CLEAR_FACTOR: f64 = 30.0;

/// Buffers of the computation, for n columns.
pub(super) struct MinimumNorm {
    /// T, then its triangle with the columns in pivot order. The omitted columns become a null space.
    matrix: Vec<f64>,
    /// b, then Qᵀb.
    rhs: Vec<f64>,
    /// Column of T at each position.
    order: Vec<usize>,
}

impl MinimumNorm {
    /// Allocates buffers for n columns.
    pub fn new(n: usize) -> Self {
        Self {
            matrix: vec![0.0; n * n],
            rhs: vec![0.0; n],
            order: vec![0; n],
        }
    }

    /// Fills w and returns ‖T·w‖, or `None` if the rank of T is zero or not clear.
    pub fn solve(&mut self, triangle: &[f64], b: &[f64], w: &mut [f64]) -> Option<f64> {
        self.matrix.copy_from_slice(triangle);
        self.rhs.copy_from_slice(b);
        for (place, column) in self.order.iter_mut().enumerate() {
            *column = place;
        }
        let rank = pivot(&mut self.matrix, &mut self.rhs, &mut self.order)?;
        let change = dot(&self.rhs[..rank], &self.rhs[..rank]).sqrt();
        shortest(&mut self.matrix, &mut self.rhs, rank);
        for (place, column) in self.order.iter().enumerate() {
            w[*column] = self.rhs[place];
        }
        Some(change)
    }
}

/// Householder triangularisation with column pivoting, the longest remaining column first [Golub & Van Loan, Matrix Computations, 2013, algorithm
/// 5.4.1]. Returns the rank.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn pivot(matrix: &mut [f64], rhs: &mut [f64], order: &mut [usize]) -> Option<usize> {
    let n = rhs.len();
    let mut first_norm = 0.0;
    for k in 0..n {
        let (mut longest, mut place) = (-1.0, k);
        for j in k..n {
            let tail = &matrix[j * n + k..(j + 1) * n];
            let square = dot(tail, tail);
            if square > longest {
                (longest, place) = (square, j);
            }
        }
        let norm = longest.sqrt();
        if k == 0 {
            first_norm = norm;
        }
        if norm <= first_norm * SMALLEST_SINGULAR_VALUE / CLEAR_FACTOR {
            return (k > 0).then_some(k);
        }
        if norm.is_nan() || norm < first_norm * SMALLEST_SINGULAR_VALUE * CLEAR_FACTOR {
            return None;
        }
        if place != k {
            let (left, right) = matrix.split_at_mut(place * n);
            left[k * n..(k + 1) * n].swap_with_slice(&mut right[..n]);
            order.swap(k, place);
        }
        let (left, right) = matrix.split_at_mut((k + 1) * n);
        let v = &mut left[k * n + k..];
        let (diagonal, scale) = householder(v)?;
        for column in right.chunks_exact_mut(n) {
            let factor = -scale * dot(v, &column[k..]);
            add_scaled(factor, v, &mut column[k..]);
        }
        let factor = -scale * dot(v, &rhs[k..]);
        add_scaled(factor, v, &mut rhs[k..]);
        v[0] = diagonal;
    }
    Some(n)
}

/// Of all solutions of [R11 R12]·y = −c, the one perpendicular to the null space [−R11⁻¹·R12; 1].
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn shortest(matrix: &mut [f64], rhs: &mut [f64], rank: usize) {
    let n = rhs.len();
    let (triangle, null_space) = matrix.split_at_mut(rank * n);
    back_substitute(triangle, &mut rhs[..rank], n);
    rhs[rank..].fill(0.0);
    for j in 0..n - rank {
        let (earlier, later) = null_space.split_at_mut(j * n);
        let v = &mut later[..n];
        back_substitute(triangle, &mut v[..rank], n);
        v[rank..].fill(0.0);
        v[rank + j] = 1.0;
        // Twice: after one pass, rounding errors of a long vector remain.
        for _ in 0..2 {
            for unit in earlier.chunks_exact(n) {
                let factor = -dot(unit, v);
                add_scaled(factor, unit, v);
            }
        }
        let norm = dot(v, v).sqrt();
        for value in v.iter_mut() {
            *value /= norm;
        }
        let factor = -dot(v, rhs);
        add_scaled(factor, v, rhs);
    }
}

/// b <- −R⁻¹·b, R the leading triangle of columns of length n.
#[inline(always)]
fn back_substitute(triangle: &[f64], b: &mut [f64], n: usize) {
    for j in (0..b.len()).rev() {
        let column = &triangle[j * n..j * n + j + 1];
        let w = -b[j] / column[j];
        b[j] = w;
        for (b, r) in b.iter_mut().zip(&column[..j]) {
            *b = r.mul_add(w, *b);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::MinimumNorm;
    use crate::solvers::least_squares::directions::Directions;
    use crate::solvers::random::{chacha8, unit_interval};
    use nalgebra::DMatrix;
    use rand::Rng;

    /// Rounding error of sums of twenty numbers of order one, times condition numbers of some hundreds.
    const ROUNDING: f64 = 1e-11;

    /// R of a random matrix with `n` columns, of which the last `n - rank` are combinations of the others.
    fn singular_triangle(seed: u64, n: usize, rank: usize) -> Vec<f64> {
        let mut random = chacha8(seed, 0);
        let mut next = || 2.0 * unit_interval(random.next_u64()) - 1.0;
        let independent = DMatrix::from_fn(3 * n, rank, |_, _| next());
        let mix = DMatrix::from_fn(rank, n, |_, _| next());
        (independent * mix).qr().r().as_slice().to_vec()
    }

    #[test]
    fn the_shortest_minimiser_is_that_of_the_singular_values() {
        for (seed, (n, rank)) in [(2, 1), (5, 3), (7, 7), (12, 11), (24, 20), (24, 6)]
            .into_iter()
            .enumerate()
        {
            let triangle = singular_triangle(seed as u64, n, rank);
            let b: Vec<f64> = (0..n).map(|i| 0.3 - 0.1 * i as f64).collect();
            let mut w = vec![0.0; n];
            let change = MinimumNorm::new(n)
                .solve(&triangle, &b, &mut w)
                .expect("its rank is clear");
            let directions = Directions::of(&triangle, &b, &vec![1.0; n]).expect("it is finite");
            let (damping, along) = directions.step_within(f64::INFINITY, 0.0);
            let expected = &directions.unscaled * nalgebra::DVector::from_vec(along.clone());
            assert_eq!(damping, 0.0);
            let size = expected.norm();
            for (w, expected) in w.iter().zip(&expected) {
                assert!(
                    (w - expected).abs() < ROUNDING * size,
                    "{n} columns, rank {rank}: {w} and {expected}"
                );
            }
            assert!(
                (change * change - directions.change(&along)).abs() < ROUNDING * change * change
            );
        }
    }

    #[test]
    fn it_leaves_alone_what_is_of_unclear_rank() {
        let mut w = [0.0; 2];
        let triangle = |last: f64| [1.0, 0.0, 1.0, last];
        for (last, is_clear) in [(0.5, true), (1e-12, false), (1e-16, true)] {
            assert_eq!(
                MinimumNorm::new(2)
                    .solve(&triangle(last), &[1.0, 1.0], &mut w)
                    .is_some(),
                is_clear,
                "{last}"
            );
        }
        assert!(
            MinimumNorm::new(2)
                .solve(&[0.0; 4], &[1.0, 1.0], &mut w)
                .is_none()
        );
        assert!(
            MinimumNorm::new(2)
                .solve(&[f64::NAN; 4], &[1.0, 1.0], &mut w)
                .is_none()
        );
    }
}
