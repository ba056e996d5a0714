//! Levenberg-Marquardt for Σ r_i², with a trust region [Moré 1978: The Levenberg-Marquardt algorithm, implementation
//! and theory, Lecture Notes in Mathematics 630, 105–116], the algorithm of MINPACK's `lmder`.
//!
//! Each step minimises ‖r + J·p‖ over ‖D·p‖ ≤ Δ. D has the running maxima of the Jacobian's column norms, so that the units of parameters do not
//! matter. Δ grows and shrinks with the ratio of actual to predicted reduction.
//!
//! There is one difference from MINPACK. J is reduced to a triangle R by Householder reflections, as in MINPACK. If the step must be damped, R·D⁻¹ is
//! decomposed into singular values, whereas MINPACK uses pivoting. The unobservable directions of the parameters are then known, and no step is made
//! along them; and each damping λ costs only a sum over the singular values. An undamped step is the shortest solution by back-substitution, which is
//! the same if the rank is clear.

mod directions;
mod linear_model;
mod minimum_norm;

use super::qr::{dot, squares};
use linear_model::{LinearModel, Step};
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector};
use std::ops::ControlFlow;

/// A step is accepted if it reaches this share of the predicted reduction [Moré 1978, algorithm 7.1].
const ACCEPTED_RATIO: f64 = 1e-4;

/// Stopping criteria.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Maximum number of trial steps: 200. From distant starts the hardest of NIST's problems take up to 800.
    pub max_iterations: usize,
    /// Stops when actual and predicted relative reduction of the cost are both at most this: 1e-15, a few rounding errors.
    pub cost_tolerance: f64,
    /// Stops when Δ is at most this share of ‖D·x‖: 1e-12.
    pub step_tolerance: f64,
    /// Stops when the cosine between the residuals and every column of the Jacobian is at most this: 1e-12.
    pub gradient_tolerance: f64,
    /// Stops as soon as the cost is at or below this: never.
    pub stop_at_cost: Option<f64>,
    /// First Δ as a multiple of ‖D·x‖, or of the residuals' norm if x is zero: 10. A smaller value is safer from a distant start. With MINPACK's 100,
    /// one of NIST's starts (BoxBOD) overshoots and ends on a plateau.
    pub initial_radius: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_iterations: 200,
            cost_tolerance: 1e-15,
            step_tolerance: 1e-12,
            gradient_tolerance: 1e-12,
            stop_at_cost: None,
            initial_radius: 10.0,
        }
    }
}

/// The information for the monitor, once for the start (iteration 0) and once after each trial step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Trial steps done, accepted or rejected.
    pub iteration: usize,
    /// Maximum number of trial steps.
    pub max_iterations: usize,
    /// Σ r_i² at the best point so far.
    pub cost: f64,
}

/// Why the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The cost no longer falls: [`Options::cost_tolerance`].
    CostTolerance,
    /// The steps are small: [`Options::step_tolerance`].
    StepTolerance,
    /// The residuals are perpendicular to the Jacobian: [`Options::gradient_tolerance`].
    GradientTolerance,
    /// The cost reached [`Options::stop_at_cost`], or is exactly zero.
    CostReached,
    /// Rounding errors prevent further progress, although the tolerances are not reached.
    NoFurtherProgress,
    /// [`Options::max_iterations`].
    IterationLimit,
    /// The residuals at the start, or a Jacobian, were not finite.
    NotFinite,
    /// The monitor stopped the search.
    Stopped,
}

impl Termination {
    /// True if a minimum was reached to the requested accuracy or to the limit of rounding.
    pub fn converged(self) -> bool {
        !matches!(self, Self::IterationLimit | Self::NotFinite | Self::Stopped)
    }
}

/// Result of the search.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The best point.
    pub x: Vec<f64>,
    /// Σ r_i² there (no ½); +∞ if the start was not finite.
    pub cost: f64,
    /// Residuals there.
    pub residuals: DVector<f64>,
    /// Trial steps done, accepted or rejected.
    pub n_iterations: usize,
    /// Number of evaluations of the residuals, including those with a Jacobian.
    pub n_evaluations: usize,
    /// Number of evaluations of the Jacobian.
    pub n_jacobians: usize,
    /// Cost of the best point at the start (index 0) and after each trial step; never rises.
    pub convergence: Vec<f64>,
    /// Why the search ended.
    pub termination: Termination,
}

/// Fills the residuals at x and, if requested, also the Jacobian d(residual)/dx, residuals × parameters.
///
/// The sign matters: residual = measured − predicted, so the Jacobian is that of the residual, the *negative* of the prediction's. Residuals that are
/// not finite reject the step; a shorter one is then tried.
pub type Problem<'a> = dyn FnMut(&[f64], &mut DVector<f64>, Option<&mut DMatrix<f64>>) + 'a;

/// Receives each iteration; `Break` stops the search.
pub type Monitor<'a> = dyn FnMut(Iteration) -> ControlFlow<()> + 'a;

/// Minimises Σ r_i² from `x0`; `problem` has `n_residuals` residuals.
pub fn minimize(
    problem: &mut Problem<'_>,
    n_residuals: usize,
    x0: &[f64],
    options: &Options,
    monitor: &mut Monitor<'_>,
) -> Summary {
    let mut search = Search::new(problem, n_residuals, x0, options);
    let termination = loop {
        let told = Iteration {
            iteration: search.n_iterations,
            max_iterations: options.max_iterations,
            cost: search.cost,
        };
        search.convergence.push(search.cost);
        if monitor(told).is_break() {
            break Termination::Stopped;
        }
        if let Some(termination) = search.ended(options) {
            break termination;
        }
        if search.linearisation_is_stale
            && let Some(termination) = search.linearise(problem, options)
        {
            break termination;
        }
        search.try_step(problem, options);
    };
    Summary {
        x: search.x,
        cost: search.cost,
        residuals: search.residuals,
        n_iterations: search.n_iterations,
        n_evaluations: search.n_evaluations,
        n_jacobians: search.n_jacobians,
        convergence: search.convergence,
        termination,
    }
}

/// The state between trial steps. All buffers are allocated once. A step allocates only if there are unobservable directions.
struct Search {
    x: Vec<f64>,
    residuals: DVector<f64>,
    cost: f64,
    trial: Vec<f64>,
    trial_residuals: DVector<f64>,
    /// Valid only between its evaluation and its reduction, which overwrites it.
    jacobian: DMatrix<f64>,
    column_norms: Vec<f64>,
    linearisation_is_stale: bool,
    model: LinearModel,
    /// D.
    scale: Vec<f64>,
    /// Δ.
    radius: f64,
    /// λ.
    damping: f64,
    /// Set by the last trial step.
    outcome: Option<Termination>,
    n_iterations: usize,
    n_evaluations: usize,
    n_jacobians: usize,
    convergence: Vec<f64>,
}

impl Search {
    fn new(problem: &mut Problem<'_>, n_residuals: usize, x0: &[f64], options: &Options) -> Self {
        let n = x0.len();
        let mut residuals = DVector::zeros(n_residuals);
        problem(x0, &mut residuals, None);
        let cost = sum_of_squares(residuals.as_slice());
        Self {
            x: x0.to_vec(),
            trial: x0.to_vec(),
            trial_residuals: DVector::zeros(n_residuals),
            residuals,
            cost,
            jacobian: DMatrix::zeros(n_residuals, n),
            column_norms: vec![0.0; n],
            linearisation_is_stale: true,
            model: LinearModel::new(n_residuals, n),
            scale: vec![0.0; n],
            radius: 0.0,
            damping: 0.0,
            outcome: (!cost.is_finite()).then_some(Termination::NotFinite),
            n_iterations: 0,
            n_evaluations: 1,
            n_jacobians: 0,
            convergence: Vec::with_capacity(options.max_iterations.min(1000) + 1),
        }
    }

    fn ended(&self, options: &Options) -> Option<Termination> {
        if self.cost == 0.0
            || options
                .stop_at_cost
                .is_some_and(|target| self.cost <= target)
        {
            return Some(Termination::CostReached);
        }
        self.outcome
            .or((self.n_iterations == options.max_iterations)
                .then_some(Termination::IterationLimit))
    }

    /// Evaluates the Jacobian, updates D, and sets Δ at the first call.
    fn linearise(&mut self, problem: &mut Problem<'_>, options: &Options) -> Option<Termination> {
        problem(&self.x, &mut self.residuals, Some(&mut self.jacobian));
        self.n_evaluations += 1;
        self.n_jacobians += 1;
        self.linearisation_is_stale = false;
        let largest_cosine = norms_and_cosine(
            self.jacobian.as_slice(),
            self.residuals.as_slice(),
            self.cost.sqrt(),
            &mut self.column_norms,
        );
        if !self.column_norms.iter().all(|norm| norm.is_finite())
            && !self.jacobian.iter().all(|value| value.is_finite())
        {
            return Some(Termination::NotFinite);
        }
        let first = self.n_jacobians == 1;
        for (scale, norm) in self.scale.iter_mut().zip(&self.column_norms) {
            *scale = if first && *norm == 0.0 {
                1.0
            } else {
                scale.max(*norm)
            };
        }
        if first {
            let length = self.scaled_norm(&self.x);
            self.radius = options.initial_radius
                * if length > 0.0 {
                    length
                } else {
                    self.cost.sqrt()
                };
        }
        if largest_cosine <= options.gradient_tolerance {
            return Some(Termination::GradientTolerance);
        }
        self.model
            .reduce(&mut self.jacobian, self.residuals.as_slice(), &self.scale);
        None
    }

    /// Tries one step and accepts it if the cost falls as predicted [Moré 1978, algorithm 7.1].
    fn try_step(&mut self, problem: &mut Problem<'_>, options: &Options) {
        let Some(Step {
            damping,
            length,
            change,
        }) = self
            .model
            .step_within(self.radius, self.damping, &self.scale)
        else {
            self.outcome = Some(Termination::NoFurtherProgress);
            return;
        };
        self.damping = damping;
        if self.n_iterations == 0 {
            self.radius = self.radius.min(length);
        }
        for ((trial, x), p) in self.trial.iter_mut().zip(&self.x).zip(self.model.step()) {
            *trial = x + p;
        }
        problem(&self.trial, &mut self.trial_residuals, None);
        self.n_evaluations += 1;
        self.n_iterations += 1;
        let cost = sum_of_squares(self.trial_residuals.as_slice());

        // reductions relative to the present cost; a tenfold (or infinite) growth counts as -1
        let actual = if 0.01 * cost < self.cost {
            1.0 - cost / self.cost
        } else {
            -1.0
        };
        let linear = change / self.cost;
        let damped = damping * length * length / self.cost;
        let predicted = linear + 2.0 * damped;
        let slope = -(linear + damped);
        let ratio = if predicted > 0.0 {
            actual / predicted
        } else {
            0.0
        };
        self.adapt_radius(ratio, actual, slope, cost, length);
        if ratio >= ACCEPTED_RATIO {
            std::mem::swap(&mut self.x, &mut self.trial);
            std::mem::swap(&mut self.residuals, &mut self.trial_residuals);
            self.cost = cost;
            self.linearisation_is_stale = true;
        }
        self.outcome = self.outcome_of(actual, predicted, ratio, options);
    }

    /// Shrinks Δ after a bad step, using the minimiser of a fitted parabola; enlarges it after a good one.
    fn adapt_radius(&mut self, ratio: f64, actual: f64, slope: f64, cost: f64, length: f64) {
        if ratio <= 0.25 {
            let mut factor = if actual >= 0.0 {
                0.5
            } else {
                0.5 * slope / (slope + 0.5 * actual)
            };
            if 0.01 * cost >= self.cost || factor < 0.1 || !cost.is_finite() {
                factor = 0.1;
            }
            self.radius = factor * self.radius.min(10.0 * length);
            self.damping /= factor;
        } else if self.damping == 0.0 || ratio >= 0.75 {
            self.radius = 2.0 * length;
            self.damping *= 0.5;
        }
    }

    fn outcome_of(
        &self,
        actual: f64,
        predicted: f64,
        ratio: f64,
        options: &Options,
    ) -> Option<Termination> {
        let small = |limit: f64| actual.abs() <= limit && predicted <= limit && 0.5 * ratio <= 1.0;
        let length = self.scaled_norm(&self.x);
        if small(options.cost_tolerance) {
            Some(Termination::CostTolerance)
        } else if self.radius <= options.step_tolerance * length {
            Some(Termination::StepTolerance)
        } else if small(f64::EPSILON)
            || self.radius <= f64::EPSILON * length
            || self.radius < f64::MIN_POSITIVE
        {
            Some(Termination::NoFurtherProgress)
        } else {
            None
        }
    }

    fn scaled_norm(&self, x: &[f64]) -> f64 {
        scaled_norm(&self.scale, x)
    }
}

/// Sum of squares; infinite if it is not finite.
pub fn sum_of_squares(residuals: &[f64]) -> f64 {
    let sum = squares(residuals);
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// Norms of the columns, and the largest cosine of the angle between the residuals and a column.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn norms_and_cosine(
    jacobian: &[f64],
    residuals: &[f64],
    residual_norm: f64,
    norms: &mut [f64],
) -> f64 {
    let mut largest = 0.0_f64;
    for (column, norm) in jacobian.chunks_exact(residuals.len().max(1)).zip(norms) {
        *norm = dot(column, column).sqrt();
        if *norm > 0.0 {
            largest = largest.max((dot(column, residuals) / (*norm * residual_norm)).abs());
        }
    }
    largest
}

fn scaled_norm(scale: &[f64], x: &[f64]) -> f64 {
    scale
        .iter()
        .zip(x)
        .fold(0.0, |sum: f64, (d, x)| sum + (d * x) * (d * x))
        .sqrt()
}
