//! Maximum a posteriori estimate of the variables of a problem, from its rows and its priors.
//!
//! The rows divided by the noise σ, and the coordinates divided by the widths of their priors, form one least-squares problem. There is no
//! rank threshold, and no parameter is held: the priors determine what the rows do not. σ and the widths are estimated as well
//! ([`crate::identification::least_squares::evidence`]): least squares and the noise estimate alternate until neither changes.

use crate::identification::KinematicModel;
use crate::identification::least_squares::evidence::{Evidence, Posterior, Triangle};
use crate::identification::least_squares::parts::Parts;
use crate::identification::least_squares::problem::Problem;
use crate::solvers::least_squares::{Iteration, Options, Termination, minimize, sum_of_squares};
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, IsometryMatrix3};
use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;

/// Start value of σ as a share of the reach, far below the noise of any robot.
const FIRST_SIGMA: f64 = 1e-6;
/// Maximum number of rounds of least squares and noise.
const ROUNDS: usize = 15;
/// The rounds end when σ and the widths change by less than this share.
const CONVERGED: f64 = 1e-3;
/// Least squares of a round ends if a step gains less than this share of the sum of squares: a thousandth of a standard deviation.
const SMALLEST_GAIN: f64 = 1e-10;
/// Least squares of a round also ends if a step is shorter than this share of the coordinates.
const SMALLEST_STEP: f64 = 1e-10;

/// Result of an estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The most probable model.
    pub model: KinematicModel,
    /// Motion of each station but the reference ([`Problem::station_motions`]).
    pub station_motions: Vec<IsometryMatrix3<f64>>,
    /// Its coordinates.
    pub x: Vec<f64>,
    /// Noise and widths.
    pub evidence: Evidence,
    /// The linear problem at the solution.
    pub posterior: Posterior,
    /// Sum of squares of rows and priors (priors times σ²) at the start and after each step of least squares, the smallest so far, mm². σ and the
    /// widths are the final ones, for which the estimate is the minimum.
    pub convergence_mm2: Vec<f64>,
    /// Coordinates at the start and after each step, each with the sum of squares of the rows, mm².
    steps: Vec<(Vec<f64>, f64)>,
    /// Number of evaluations of the residuals.
    pub n_evaluations: usize,
    /// Why the last round ended.
    pub termination: Termination,
}

/// A fit without its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct FitSummary {
    /// The fitted model.
    pub model: KinematicModel,
    /// Motion of each station but the reference ([`Problem::station_motions`]).
    pub station_motions: Vec<IsometryMatrix3<f64>>,
    /// Number of steps, over all rounds.
    pub n_iterations: usize,
    /// Number of evaluations of the residuals.
    pub n_evaluations: usize,
    /// Sum of squares at the start and after each step, mm²; never rises.
    pub convergence_mm2: Vec<f64>,
    /// Why it ended.
    pub termination: Termination,
}

impl Estimate {
    /// The state before the first round, with the given noise and widths.
    fn before(problem: &Problem<'_>, start: &[f64], evidence: Evidence) -> Self {
        Self {
            model: problem.model(start),
            station_motions: problem.station_motions(start),
            x: start.to_vec(),
            // Without rows, the posterior equals the prior.
            posterior: Triangle::empty(start.len()).solve(start, &evidence),
            evidence,
            convergence_mm2: vec![],
            steps: vec![],
            n_evaluations: 0,
            termination: Termination::IterationLimit,
        }
    }

    /// Computes the convergence curve with the final noise and widths.
    fn with_curve(mut self, problem: &Problem<'_>) -> Self {
        let mut least = f64::INFINITY;
        self.convergence_mm2.clear();
        for (x, rows_mm2) in &self.steps {
            let sum = rows_mm2 + prior_sum_mm2(problem, x, &self.evidence);
            least = least.min(sum);
            self.convergence_mm2.push(least);
        }
        self
    }

    /// The summary of this estimate.
    pub fn into_summary(self) -> FitSummary {
        FitSummary {
            model: self.model,
            station_motions: self.station_motions,
            n_iterations: self.convergence_mm2.len().saturating_sub(1),
            n_evaluations: self.n_evaluations,
            convergence_mm2: self.convergence_mm2,
            termination: self.termination,
        }
    }
}

/// The rows of a problem, evaluated at once or in parts.
struct Rows<'a> {
    problem: &'a Problem<'a>,
    parts: Option<Parts<'a>>,
    watch: &'a Watch<'a>,
}

impl<'a> Rows<'a> {
    fn new(problem: &'a Problem<'a>, watch: &'a Watch<'a>) -> Self {
        Self {
            problem,
            parts: Parts::of(problem),
            watch,
        }
    }

    fn triangle(&self, x: &[f64]) -> Triangle {
        match &self.parts {
            Some(parts) => parts.triangle(x, self.watch),
            None => Triangle::at(self.problem, x),
        }
    }

    /// Number of rows for least squares: those of the problem. For a problem in parts: those of its triangle, and one for the rest.
    fn n(&self) -> usize {
        match &self.parts {
            Some(_) => self.problem.variables.len() + 1,
            None => self.problem.n_rows(),
        }
    }

    /// Evaluates the rows. For a problem in parts, the rows of the triangle are returned: they have the same sum of squares, and the same
    /// derivatives of it. Without `jacobian`, only the sum is computed, as a single row.
    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: Option<&mut DMatrix<f64>>) {
        let (Some(parts), p) = (&self.parts, x.len()) else {
            return self.problem.evaluate(x, residuals, jacobian);
        };
        let Some(jacobian) = jacobian else {
            residuals[..p].fill(0.0);
            residuals[p] = parts.sum_of_squares(x, self.watch).sqrt();
            return;
        };
        let triangle = parts.triangle(x, self.watch);
        let (r, right, rest) = triangle.reduced();
        residuals[..p].copy_from_slice(right);
        residuals[p] = rest.sqrt();
        jacobian.rows_mut(0, p).copy_from(r);
        jacobian.row_mut(p).fill(0.0);
    }
}

/// The estimate from `start` on (coordinates). It ends early if the sum of squares is at most `stop_at_mm2`. The monitor receives sums of squares,
/// mm².
pub fn estimate(
    problem: &Problem<'_>,
    start: &[f64],
    stop_at_mm2: f64,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> Estimate {
    let evidence = Evidence::first(problem, FIRST_SIGMA * problem.reach_mm);
    let ends = Ends {
        at_mm2: stop_at_mm2,
        ..Ends::AT_MINIMUM
    };
    estimate_from(problem, start, evidence, ends, monitor)
}

/// When least squares ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ends {
    /// If the sum of squares is at most this, mm².
    pub at_mm2: f64,
    /// If a step gains less than this share of the sum of squares.
    pub smallest_gain: f64,
}

impl Ends {
    /// At the minimum, to rounding.
    pub const AT_MINIMUM: Self = Self {
        at_mm2: 0.0,
        smallest_gain: SMALLEST_GAIN,
    };
}

/// As [`estimate`], starting with the given noise and widths.
pub fn estimate_from(
    problem: &Problem<'_>,
    start: &[f64],
    evidence: Evidence,
    ends: Ends,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> Estimate {
    let least_sigma_mm = problem.least_sigma_mm;
    let mut found = Estimate::before(problem, start, evidence);
    // Between parts of the rows, the monitor is called again with the last iteration.
    let (monitor, told) = (RefCell::new(monitor), Cell::new(None));
    let ask = || {
        told.get()
            .is_none_or(|i| monitor.borrow_mut()(i).is_continue())
    };
    let watch = Watch::new(&ask);
    let mut tell = |i: Iteration| {
        told.set(Some(i));
        match watch.was_stopped() {
            true => ControlFlow::Break(()),
            false => monitor.borrow_mut()(i),
        }
    };
    let rows = Rows::new(problem, &watch);
    for _ in 0..ROUNDS {
        descend(&rows, &mut found, ends, &mut tell);
        let triangle = rows.triangle(&found.x);
        let before = found.evidence.clone();
        found.evidence = triangle.evidence(problem, &found.x, before.clone(), least_sigma_mm);
        found.posterior = triangle.solve(&found.x, &found.evidence);
        let is_over = matches!(
            found.termination,
            Termination::Stopped | Termination::CostReached
        );
        if is_over || found.evidence.is_near(&before, CONVERGED) {
            break;
        }
    }
    found.with_curve(problem)
}

/// Least squares of the rows, starting at `start`. σ is far below the noise, so that the priors determine only what the rows do not.
pub fn least_squares(problem: &Problem<'_>, start: &KinematicModel) -> KinematicModel {
    least_squares_while(problem, start, &Watch::nobody()).model
}

/// As [`least_squares`], until the watch stops.
pub fn least_squares_while(
    problem: &Problem<'_>,
    start: &KinematicModel,
    watch: &Watch<'_>,
) -> FitSummary {
    let evidence = Evidence::first(problem, FIRST_SIGMA * problem.reach_mm);
    most_probable(problem, start, &evidence, watch)
}

/// Maximum a posteriori model with given noise and widths, beginning at `start`.
pub fn most_probable(
    problem: &Problem<'_>,
    start: &KinematicModel,
    evidence: &Evidence,
    watch: &Watch<'_>,
) -> FitSummary {
    let start = problem.coordinates(start);
    let mut found = Estimate::before(problem, &start, evidence.clone());
    let rows = Rows::new(problem, watch);
    descend(&rows, &mut found, Ends::AT_MINIMUM, &mut |_| watch.flow());
    found.with_curve(problem).into_summary()
}

/// Cost of the priors at a model, mm²: σ²·Σ (x_j/w_j)².
pub fn prior_cost_mm2(problem: &Problem<'_>, model: &KinematicModel, evidence: &Evidence) -> f64 {
    prior_sum_mm2(problem, &problem.coordinates(model), evidence)
}

fn prior_sum_mm2(problem: &Problem<'_>, x: &[f64], evidence: &Evidence) -> f64 {
    let away = |j: usize| (x[j] - problem.expected(j)) / evidence.widths[j];
    let squares: f64 = (0..x.len()).map(|j| away(j) * away(j)).sum();
    evidence.sigma_mm * evidence.sigma_mm * squares
}

/// Noise, widths and posterior of the linear problem at the given coordinates, which need not be the estimate.
pub fn evidence_at(problem: &Problem<'_>, x: &[f64]) -> (Evidence, Posterior) {
    let triangle = Rows::new(problem, &Watch::nobody()).triangle(x);
    let first = Evidence::first(problem, FIRST_SIGMA * problem.reach_mm);
    let least_sigma_mm = problem.least_sigma_mm;
    let evidence = triangle.evidence(problem, x, first, least_sigma_mm);
    let posterior = triangle.solve(x, &evidence);
    (evidence, posterior)
}

/// The posterior of the linear problem at the given coordinates, with known noise and widths.
pub fn posterior_at(problem: &Problem<'_>, x: &[f64], evidence: &Evidence) -> Posterior {
    let triangle = Rows::new(problem, &Watch::nobody()).triangle(x);
    triangle.solve(x, evidence)
}

/// Least squares of rows and priors from the current coordinates on, with fixed noise and widths.
fn descend(
    rows_of: &Rows<'_>,
    found: &mut Estimate,
    ends: Ends,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) {
    let problem = rows_of.problem;
    let (n_rows, widths) = (rows_of.n(), &found.evidence.widths);
    let sigma_mm = found.evidence.sigma_mm;
    // Evaluations since the last step: minimised sum of squares, coordinates, sum of squares of the rows.
    let evaluated: RefCell<Vec<(f64, Vec<f64>, f64)>> = RefCell::default();
    let mut rows =
        |x: &[f64], residuals: &mut DVector<f64>, mut jacobian: Option<&mut DMatrix<f64>>| {
            rows_of.evaluate(x, residuals.as_mut_slice(), jacobian.as_deref_mut());
            let rows_mm2 = residuals.rows(0, n_rows).norm_squared();
            residuals.rows_mut(0, n_rows).scale_mut(1.0 / sigma_mm);
            for (j, width) in widths.iter().enumerate() {
                residuals[n_rows + j] = (x[j] - problem.expected(j)) / width;
            }
            let sum = sum_of_squares(residuals.as_slice());
            evaluated.borrow_mut().push((sum, x.to_vec(), rows_mm2));
            if let Some(jacobian) = jacobian {
                jacobian.rows_mut(0, n_rows).scale_mut(1.0 / sigma_mm);
                jacobian.rows_mut(n_rows, widths.len()).fill(0.0);
                for (j, width) in widths.iter().enumerate() {
                    jacobian[(n_rows + j, j)] = 1.0 / width;
                }
            }
        };
    let options = Options {
        cost_tolerance: ends.smallest_gain,
        step_tolerance: SMALLEST_STEP,
        stop_at_cost: Some(ends.at_mm2 / (sigma_mm * sigma_mm)),
        ..Options::default()
    };
    let (steps, told_mm2) = (&mut found.steps, &mut found.convergence_mm2);
    let done = steps.len().saturating_sub(1);
    let mut watch = |i: Iteration| {
        let mut since = evaluated.borrow_mut();
        let here = since.iter().rposition(|(sum, ..)| *sum == i.cost);
        let here = here.map(|k| since.swap_remove(k));
        // The first iteration of a later round repeats the last one of the previous round.
        if let Some((_, x, rows_mm2)) = here
            .as_ref()
            .filter(|_| i.iteration > 0 || steps.is_empty())
        {
            steps.push((x.clone(), *rows_mm2));
        }
        since.clear();
        since.extend(here);
        let cost_mm2 = i.cost * sigma_mm * sigma_mm;
        let least_mm2 = told_mm2.last().map_or(cost_mm2, |told| told.min(cost_mm2));
        told_mm2.push(least_mm2);
        monitor(Iteration {
            iteration: done + i.iteration,
            max_iterations: done + i.max_iterations,
            cost: least_mm2,
        })
    };
    let n = n_rows + widths.len();
    let fit = minimize(&mut rows, n, &found.x, &options, &mut watch);
    found.n_evaluations += fit.n_evaluations;
    found.termination = fit.termination;
    found.model = problem.model(&fit.x);
    found.station_motions = problem.station_motions(&fit.x);
    found.x = fit.x;
}
