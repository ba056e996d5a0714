//! Splits a large problem into parts. Its rows are reduced part by part, so that no matrix of all rows is in memory, and cancellation is checked in
//! between.

use crate::identification::least_squares::evidence::Triangle;
use crate::identification::least_squares::problem::Problem;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector};

/// Number of blocks of a part. Its derivatives with respect to forty coordinates fit into a processor's cache.
const BLOCKS_AT_ONCE: usize = 200;
/// Problems with at most this number of blocks stay in one part: their matrix is small.
const MIN_BLOCKS: usize = 1_000;
/// Number of parts between two checks whether to stop.
const PARTS_PER_CHECK: usize = 10;

/// A problem that is too large for one matrix, in parts.
pub struct Parts<'a> {
    parts: Vec<Problem<'a>>,
    n_coordinates: usize,
}

impl<'a> Parts<'a> {
    /// `None` for a problem that is small enough for one matrix.
    pub fn of(problem: &Problem<'a>) -> Option<Self> {
        let n = problem.n_blocks();
        let first = (0..n).step_by(BLOCKS_AT_ONCE);
        let part = |i: usize| problem.part(i..n.min(i + BLOCKS_AT_ONCE));
        (n > MIN_BLOCKS).then(|| Self {
            parts: first.map(part).collect(),
            n_coordinates: problem.variables.len(),
        })
    }

    /// Sum of squares of all rows; infinite if the watch stops.
    pub fn sum_of_squares(&self, x: &[f64], watch: &Watch<'_>) -> f64 {
        let (mut sum, mut residuals) = (0.0, Vec::new());
        for (i, part) in self.parts.iter().enumerate() {
            if i % PARTS_PER_CHECK == 0 && !watch.goes_on() {
                return f64::INFINITY;
            }
            residuals.clear();
            residuals.resize(part.n_rows(), 0.0);
            part.evaluate(x, &mut residuals, None);
            sum += DVector::from_column_slice(&residuals).norm_squared();
        }
        sum
    }

    /// The triangle R of all rows. If the watch stops, only some of the rows are in it.
    pub fn triangle(&self, x: &[f64], watch: &Watch<'_>) -> Triangle {
        let mut triangle = Triangle::empty(self.n_coordinates);
        for (i, part) in self.parts.iter().enumerate() {
            if i % PARTS_PER_CHECK == 0 && !watch.goes_on() {
                break;
            }
            let mut residuals = vec![0.0; part.n_rows()];
            let mut jacobian = DMatrix::zeros(part.n_rows(), self.n_coordinates);
            part.evaluate(x, &mut residuals, Some(&mut jacobian));
            triangle.append(&[(jacobian, residuals)]);
        }
        if let Some(part) = self.parts.first() {
            triangle.expect(part, self.n_coordinates);
        }
        triangle
    }
}
