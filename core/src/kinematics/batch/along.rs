//! Chain rule: from derivatives along each moved quantity to those along the requested directions, eight poses side by side.

use super::lanes::{LANES, Lanes, Vector};
use super::robots::Moved;
use nalgebra::Matrix3;

/// The requested derivatives: along `directions` (p × r, column-major) in the space of `moved`.
#[derive(Clone, Copy, Debug)]
pub struct Along<'a> {
    /// p quantities.
    pub moved: &'a [Moved],
    /// p × r, column-major.
    pub directions: &'a [f64],
    /// J(w) of the base's rotation vector: the base rotates by J·dw.
    pub left_jacobian: &'a Matrix3<f64>,
}

/// Number of directions that are summed side by side.
const DIRECTIONS_AT_ONCE: usize = 4;

/// −sqrt(weight) · Σ raw · direction, for all directions, into rows `first` … of the Jacobian's columns.
#[inline(always)]
pub(super) fn combine<const W: usize>(
    root_weight: &Lanes,
    along: &Along<'_>,
    raw: &[[Lanes; 3]],
    first: usize,
    n_rows: usize,
    jacobian: &mut [f64],
) {
    let p = along.moved.len();
    let mut blocks = along.directions.chunks_exact(p * DIRECTIONS_AT_ONCE);
    let mut columns = jacobian.chunks_exact_mut(n_rows * DIRECTIONS_AT_ONCE);
    for (block, columns) in (&mut blocks).zip(&mut columns) {
        combine_block::<W, DIRECTIONS_AT_ONCE>(root_weight, block, raw, first, n_rows, columns);
    }
    let rest = columns.into_remainder().chunks_exact_mut(n_rows);
    for (direction, column) in blocks.remainder().chunks_exact(p).zip(rest) {
        combine_block::<W, 1>(root_weight, direction, raw, first, n_rows, column);
    }
}

#[inline(always)]
fn combine_block<const W: usize, const K: usize>(
    root_weight: &Lanes,
    directions: &[f64],
    raw: &[[Lanes; 3]],
    first: usize,
    n_rows: usize,
    columns: &mut [f64],
) {
    let p = raw.len();
    for part in 0..Vector::<W>::PER_CHUNK {
        let mut sums = [[Vector::<W>::splat(0.0); 3]; K];
        for (row, raw) in raw.iter().enumerate() {
            let raw = Vector::<W>::load_all(raw, part);
            for k in 0..K {
                let factor = Vector::splat(directions[k * p + row]);
                for axis in 0..3 {
                    sums[k][axis] = factor.mul_add(raw[axis], sums[k][axis]);
                }
            }
        }
        let root = Vector::<W>::load(root_weight, part);
        for (k, sums) in sums.iter().enumerate() {
            for (axis, sum) in sums.iter().enumerate() {
                (-(root * *sum)).store_at(columns, k * n_rows + first + axis * LANES + part * W);
            }
        }
    }
}
