//! Least squares on a search space.

use crate::identification::KinematicModel;
use crate::identification::objective::{Observation, weighted_jacobian, weighted_residuals};
use crate::identification::parameters::Parameter;
use crate::identification::search_space::SearchSpace;
use crate::solvers::least_squares::{Iteration, Options, Summary, minimize};
use nalgebra::{DMatrix, DVector};
use std::ops::ControlFlow;

/// A least-squares fit: the model and how it was reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The fitted model.
    pub model: KinematicModel,
    /// Deviations from the space's reference, mm or rad.
    pub deviation: Vec<f64>,
    /// Iterations, evaluations, convergence.
    pub summary: Summary,
}

/// Levenberg-Marquardt with the analytic Jacobian from the space's reference.
pub fn fit_in_space(
    space: &SearchSpace,
    observations: &[Observation],
    options: &Options,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> Fit {
    let mut problem = |z: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>| {
        let deviation = space.deviation(z);
        let model = crate::identification::parameters::apply(&space.reference, &space.parameters, &deviation);
        residuals.copy_from(&weighted_residuals(&model, observations));
        if let Some(jacobian) = jacobian {
            let by_parameter = weighted_jacobian(&model, &space.parameters, observations, &space.base_rotation(&deviation));
            // d(residual) = −d(prediction)
            jacobian.gemm(-1.0, &by_parameter, space.directions(), 0.0);
        }
    };
    let start = vec![0.0; space.n_coordinates()];
    let summary = minimize(&mut problem, 3 * observations.len(), &start, options, monitor);
    Fit { model: space.model(&summary.x), deviation: space.deviation(&summary.x), summary }
}

/// Least squares on raw parameters from `start`, to the end, without a monitor: for base and targets, where all are seen.
pub fn fit_least_squares(start: &KinematicModel, parameters: &[Parameter], observations: &[Observation]) -> Fit {
    let space = SearchSpace::raw(start.clone(), parameters.to_vec(), vec![1.0; parameters.len()]);
    fit_in_space(&space, observations, &Options::default(), &mut |_| ControlFlow::Continue(()))
}
