//! Derivatives of a problem's rows against central differences.

use kincal::identification::least_squares::problem::Problem;
use kincal::identification::model::parameters::Parameter;
use nalgebra::{DMatrix, DVector};

/// Step of each coordinate. Central differences err by its square over 6 of the third derivative.
const STEP: f64 = 1e-3;
/// Relative error of a column: the third derivative of a turn is no larger than the first.
const DIFFERENCES: f64 = 1e-6;

/// # Panics
/// If a column of the Jacobian at `x` is not that of central differences.
pub fn assert_derivatives(problem: &Problem<'_>, parameters: &[Parameter], x: &[f64]) {
    let residuals = |x: &[f64]| {
        let mut rows = DVector::zeros(problem.n_rows());
        problem.evaluate(x, rows.as_mut_slice(), None);
        rows
    };
    let mut jacobian = DMatrix::zeros(problem.n_rows(), x.len());
    problem.evaluate(x, residuals(x).as_mut_slice(), Some(&mut jacobian));
    for (j, parameter) in parameters.iter().enumerate() {
        let at = |step: f64| {
            let mut moved = x.to_vec();
            moved[j] += step;
            residuals(&moved)
        };
        let difference = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        let error = (difference - jacobian.column(j)).norm() / jacobian.column(j).norm();
        assert!(error < DIFFERENCES, "{parameter:?}: {error}");
    }
}
