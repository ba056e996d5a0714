//! The rows of a problem in parts. They are reduced part by part, so that no matrix of all rows is in memory, and cancellation is checked in between.

use crate::identification::least_squares::evidence::Triangle;
use crate::identification::least_squares::problem::Problem;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector};

/// Number of blocks of a part. Its derivatives by forty coordinates fit into a processor's cache.
const BLOCKS_AT_ONCE: usize = 200;
/// Number of parts between two questions whether to go on.
const PARTS_BETWEEN: usize = 10;

/// A problem in parts.
pub struct Parts<'a> {
    parts: Vec<Problem<'a>>,
}

impl<'a> Parts<'a> {
    /// The parts of a problem; one without rows if it has none.
    pub fn of(problem: &Problem<'a>) -> Self {
        let n = problem.n_blocks();
        let first = (0..n.max(1)).step_by(BLOCKS_AT_ONCE);
        let part = |i: usize| problem.part(i..n.min(i + BLOCKS_AT_ONCE));
        Self {
            parts: first.map(part).collect(),
        }
    }

    /// Sum of squares of all rows; infinite if the watch stops.
    pub fn sum_of_squares(&self, x: &[f64], watch: &Watch<'_>) -> f64 {
        let (mut sum, mut residuals) = (0.0, Vec::new());
        for (i, part) in self.parts.iter().enumerate() {
            if i > 0 && i % PARTS_BETWEEN == 0 && !watch.goes_on() {
                return f64::INFINITY;
            }
            residuals.clear();
            residuals.resize(part.n_rows(), 0.0);
            part.evaluate(x, &mut residuals, None);
            sum += DVector::from_column_slice(&residuals).norm_squared();
        }
        sum
    }

    /// All rows as a triangle; only some of them if the watch stops.
    pub fn triangle(&self, x: &[f64], watch: &Watch<'_>) -> Triangle {
        let mut triangle = Triangle::empty(x.len());
        for (i, part) in self.parts.iter().enumerate() {
            if i > 0 && i % PARTS_BETWEEN == 0 && !watch.goes_on() {
                break;
            }
            let mut residuals = vec![0.0; part.n_rows()];
            let mut jacobian = DMatrix::zeros(part.n_rows(), x.len());
            part.evaluate(x, &mut residuals, Some(&mut jacobian));
            triangle.append(&[(jacobian, residuals)]);
        }
        triangle.expect(&self.parts[0]);
        triangle
    }
}
