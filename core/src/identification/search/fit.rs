//! Least squares in a search space.

use crate::identification::KinematicModel;
use crate::identification::least_squares::linearisation::Linearisation;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::Parameter;
use crate::identification::model::search_space::SearchSpace;
use crate::solvers::least_squares::{Iteration, Options, Summary, minimize};
use nalgebra::{DMatrix, DVector};
use std::ops::ControlFlow;

/// A least-squares fit: the model and its summary.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The fitted model.
    pub model: KinematicModel,
    /// Deviations from the space's reference, mm or rad.
    pub deviation: Vec<f64>,
    /// Iterations, evaluations, convergence; residuals in the order of [`Linearisation`].
    pub summary: Summary,
}

/// Levenberg-Marquardt with the analytic Jacobian, starting at the space's reference.
pub fn fit_in_space(
    space: &SearchSpace,
    observations: &[Observation],
    options: &Options,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> Fit {
    let mut linearisation = Linearisation::new(space, observations);
    let n_rows = linearisation.n_rows();
    let mut problem =
        |z: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>| {
            let residuals = residuals.as_mut_slice();
            match jacobian {
                Some(jacobian) => linearisation.linearise(z, residuals, jacobian.as_mut_slice()),
                None => linearisation.residuals(z, residuals),
            }
        };
    let start = vec![0.0; space.n_coordinates()];
    let summary = minimize(&mut problem, n_rows, &start, options, monitor);
    Fit {
        model: space.model(&summary.x),
        deviation: space.deviation(&summary.x),
        summary,
    }
}

/// Least squares on raw parameters, from `start` to convergence, without a monitor. It is for base and targets, which are all observable.
pub fn fit_least_squares(
    start: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
) -> Fit {
    let space = SearchSpace::raw(
        start.clone(),
        parameters.to_vec(),
        vec![1.0; parameters.len()],
    );
    fit_in_space(&space, observations, &Options::default(), &mut |_| {
        ControlFlow::Continue(())
    })
}
