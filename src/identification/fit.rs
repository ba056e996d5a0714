//! Least squares on a search space.

use crate::identification::KinematicModel;
use crate::identification::linearisation::Linearisation;
use crate::identification::linearisation::decomposition_at;
use crate::identification::objective::Observation;
use crate::identification::parameters::Parameter;
use crate::identification::search_space::SearchSpace;
use crate::solvers::least_squares::{Iteration, Options, Summary, Termination, minimize};
use nalgebra::{DMatrix, DVector};
use std::ops::ControlFlow;

/// A least-squares fit: the model and how it was reached.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The fitted model.
    pub model: KinematicModel,
    /// Deviations from the space's reference, mm or rad.
    pub deviation: Vec<f64>,
    /// Iterations, evaluations, convergence; residuals in the order of [`Linearisation`].
    pub summary: Summary,
}

/// Levenberg-Marquardt with the analytic Jacobian from the space's reference.
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

/// Least squares on raw parameters from `start`, to the end, without a monitor: for base and targets, where all are seen.
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

/// After least squares has converged, the seen directions are taken anew at its answer and it goes on, at most this often.
const MAX_ROUNDS: usize = 3;
/// A round that lowers F by less than this share is the last.
const ROUND_GAIN: f64 = 1e-6;
/// Least squares stops when the points fit to this, rms, mm: a picometre, the last digit that any of our files holds.
const EXACT_MM: f64 = 1e-9;

/// Least squares along the directions that the data see.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenFit {
    /// The fitted model.
    pub model: KinematicModel,
    /// Steps, over all rounds.
    pub n_iterations: usize,
    /// Evaluations of the residuals.
    pub n_evaluations: usize,
    /// F at the start and after each step; never rises.
    pub convergence: Vec<f64>,
    /// Why it ended.
    pub termination: Termination,
}

/// Levenberg-Marquardt from `start` along the directions that the data see; what they do not see stays. `scale` holds the parameters'
/// priors, `stop_at_cost` an F that is good enough. The monitor counts iterations over all rounds.
pub fn fit_along_seen(
    start: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
    stop_at_cost: f64,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> SeenFit {
    let along_seen = |model: &KinematicModel| {
        let directions = decomposition_at(model, parameters, scale, observations).seen_directions();
        SearchSpace::along(
            model.clone(),
            parameters.to_vec(),
            scale.to_vec(),
            directions,
        )
    };
    let exact = observations.len() as f64 * EXACT_MM * EXACT_MM;
    let options = Options {
        stop_at_cost: Some(stop_at_cost.max(exact)),
        ..Options::default()
    };
    let termination = Termination::IterationLimit;
    let mut found = SeenFit {
        model: start.clone(),
        n_iterations: 0,
        n_evaluations: 0,
        convergence: vec![],
        termination,
    };
    for round in 0..MAX_ROUNDS {
        let space = along_seen(&found.model);
        let done = found.n_iterations;
        let mut watch = |i: Iteration| {
            monitor(Iteration {
                iteration: done + i.iteration,
                max_iterations: done + i.max_iterations,
                cost: i.cost,
            })
        };
        let fit = fit_in_space(&space, observations, &options, &mut watch);
        found.n_iterations += fit.summary.n_iterations;
        found.n_evaluations += fit.summary.n_evaluations;
        let before = fit.summary.convergence[0];
        // the first entry of a later round repeats the last of the round before
        found
            .convergence
            .extend(fit.summary.convergence.iter().skip(usize::from(round > 0)));
        (found.model, found.termination) = (fit.model, fit.summary.termination);
        let is_last = matches!(
            found.termination,
            Termination::CostReached | Termination::Stopped
        );
        if is_last || fit.summary.cost > before * (1.0 - ROUND_GAIN) {
            break;
        }
    }
    found
}
