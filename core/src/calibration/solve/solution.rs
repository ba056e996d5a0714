//! The answer of a method, and least squares.

use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::problem::Problem;
use crate::calibration::{Error, Event, Monitor};
use crate::identification::KinematicModel;
use crate::identification::model::search_space::SearchSpace;
use crate::solvers::watch::Watch;
use crate::solvers::{least_squares, pso};
use nalgebra::IsometryMatrix3;
use std::cell::RefCell;

/// A method's answer.
pub struct Found {
    /// The identified model.
    pub model: KinematicModel,
    /// Motion of each station but the reference, from the problem's placement to the model; empty with one station, and after a swarm.
    pub station_motions: Vec<IsometryMatrix3<f64>>,
    /// Iterations done.
    pub n_iterations: usize,
    /// Cost evaluations done.
    pub n_evaluations: usize,
    /// Smallest F after each iteration.
    pub convergence: Vec<f64>,
    /// Why it stopped.
    pub termination: &'static str,
    /// The swarm's result and its search space, for training the network.
    pub swarm: Option<(SearchSpace, pso::Summary)>,
}

/// Least squares: the maximum a posteriori estimate. With a loss other than squares, it is iteratively reweighted. `stop_at_cost_mm2` is for the main
/// method. Refinement and comparison pass `None` and run to convergence.
pub fn least_squares_from(
    problem: &Problem<'_>,
    start: &KinematicModel,
    stop_at_cost_mm2: Option<f64>,
    monitor: &mut Monitor<'_>,
) -> Result<Found, Error> {
    let stop_at = stop_at_cost_mm2.unwrap_or(0.0);
    let monitor = RefCell::new(monitor);
    let mut tell = |i: least_squares::Iteration| {
        monitor.borrow_mut()(Event::Iteration {
            iteration: i.iteration,
            n_iterations: i.max_iterations,
            best_cost_mm2: i.cost,
        })
    };
    let ask = || monitor.borrow_mut()(Event::Heartbeat).is_continue();
    let watch = Watch::new(&ask);
    let fit = match problem.loss {
        PointLoss::Squares => problem.fit(start, stop_at, &mut tell),
        PointLoss::Bounded { .. } => problem.robust_fit(start, &watch, &mut tell),
    };
    if fit.termination == least_squares::Termination::Stopped || watch.was_stopped() {
        return Err(Error::Cancelled);
    }
    Ok(Found {
        model: fit.model,
        station_motions: fit.station_motions,
        n_iterations: fit.n_iterations,
        n_evaluations: fit.n_evaluations,
        convergence: fit.convergence_mm2,
        termination: least_squares_termination(fit.termination),
        swarm: None,
    })
}

fn least_squares_termination(termination: least_squares::Termination) -> &'static str {
    match termination {
        least_squares::Termination::CostReached => "cost_reached",
        least_squares::Termination::IterationLimit => "iteration_limit",
        least_squares::Termination::NotFinite => "not_finite",
        t if t.converged() => "converged",
        _ => "stopped",
    }
}
