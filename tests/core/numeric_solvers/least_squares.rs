//! Levenberg-Marquardt, compared with closed forms and certified problems.

use super::nist::{Problem, problems};
use kincal::solvers::least_squares::{Iteration, Options, Summary, Termination, minimize};
use nalgebra::{DMatrix, DVector};
use std::ops::ControlFlow;

fn go_on(_: Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Correct digits of a number: the log relative error, at most 11, because NIST prints 11 digits.
fn digits(computed: f64, certified: f64) -> f64 {
    let relative = ((computed - certified) / certified).abs();
    if relative.is_nan() {
        0.0
    } else {
        (-relative.max(1e-11).log10()).max(0.0)
    }
}

fn fewest_digits(computed: &[f64], certified: &[f64]) -> f64 {
    computed
        .iter()
        .zip(certified)
        .map(|(x, c)| digits(*x, *c))
        .fold(f64::INFINITY, f64::min)
}

fn solve(problem: &Problem, start: &[f64], options: &Options) -> Summary {
    let mut evaluate =
        |b: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>| problem.evaluate(b, r, j);
    minimize(
        &mut evaluate,
        problem.data.len(),
        start,
        options,
        &mut go_on,
    )
}

/// Trial steps for NIST's far starts, of which Bennett5 takes most (760).
const MANY_ITERATIONS: usize = 3000;

/// Digits that every start must reach in every parameter. The flattest minimum, Lanczos3, allows six or seven: there the
/// cost changes by its last bit.
const REQUIRED_DIGITS: f64 = 6.0;

/// Starts (problem, 1 or 2) that do not converge with the default options, even with more iterations.
const NOT_CONVERGING: [(&str, usize); 0] = [];

#[test]
fn the_data_give_the_certified_sums_of_squares_at_the_certified_parameters() {
    /// Tolerance: parameters and sums are printed to 11 digits, the last of which may be rounded.
    const PRINTED_DIGITS: f64 = 10.0;
    for problem in problems() {
        let mut residuals = DVector::zeros(problem.data.len());
        problem.evaluate(&problem.certified, &mut residuals, None);
        let rss = residuals.iter().map(|r| r * r).sum();
        assert!(
            digits(rss, problem.certified_rss) >= PRINTED_DIGITS,
            "{}: {rss}",
            problem.name
        );
    }
}

#[test]
fn the_problems_jacobians_agree_with_central_differences() {
    /// Relative step. The error of the differences is the square of the step over the length scale of the model's curvature,
    /// at worst a thousandth (Eckerle4: a peak at 451 with a width of 4), plus rounding / step.
    const STEP: f64 = 1e-5;
    const TOLERANCE: f64 = 1e-6;
    for problem in problems() {
        let (m, n) = (problem.data.len(), problem.certified.len());
        let (mut above, mut below, mut jacobian) =
            (DVector::zeros(m), DVector::zeros(m), DMatrix::zeros(m, n));
        problem.evaluate(&problem.certified, &mut above, Some(&mut jacobian));
        for j in 0..n {
            let mut b = problem.certified.clone();
            let h = STEP * b[j].abs();
            b[j] += h;
            problem.evaluate(&b, &mut above, None);
            b[j] -= 2.0 * h;
            problem.evaluate(&b, &mut below, None);
            let differences = (&above - &below) / (2.0 * h);
            let error = (&differences - jacobian.column(j)).amax() / jacobian.column(j).amax();
            assert!(
                error < TOLERANCE,
                "{} parameter {j}: {error:e}",
                problem.name
            );
        }
    }
}

#[test]
fn the_nist_problems_are_solved_from_both_starts_to_six_digits() {
    let options = Options {
        max_iterations: MANY_ITERATIONS,
        ..Options::default()
    };
    let mut not_converging = Vec::new();
    for problem in problems() {
        for (which, start) in problem.starts.iter().enumerate() {
            let summary = solve(&problem, start, &options);
            let (x, rss) = (
                fewest_digits(&summary.x, &problem.certified),
                digits(summary.cost, problem.certified_rss),
            );
            println!(
                "{:8} start {}: {x:4.1} digits in the parameters, {rss:4.1} in the sum of squares; {} steps, {} Jacobians, {:?}",
                problem.name,
                which + 1,
                summary.n_iterations,
                summary.n_jacobians,
                summary.termination
            );
            if x < REQUIRED_DIGITS || rss < REQUIRED_DIGITS {
                not_converging.push((problem.name.clone(), which + 1));
            } else {
                assert!(
                    summary.termination.converged(),
                    "{} start {}: {:?}",
                    problem.name,
                    which + 1,
                    summary.termination
                );
            }
        }
    }
    let expected = NOT_CONVERGING.map(|(name, which)| (name.to_owned(), which));
    assert_eq!(not_converging, expected);
}

#[test]
fn a_first_radius_of_100_would_lose_boxbod() {
    // Why the default is 10: the plateau b2 → ∞, where all predictions are b1, fits with 9771.5 instead of 1168.
    let problem = problems()
        .into_iter()
        .find(|problem| problem.name == "BoxBOD")
        .expect("it is in the file");
    let options = Options {
        initial_radius: 100.0,
        ..Options::default()
    };
    let summary = solve(&problem, &problem.starts[0], &options);
    assert!(summary.termination.converged());
    assert!(
        digits(summary.cost, 9771.5) > REQUIRED_DIGITS,
        "{}",
        summary.cost
    );
}

/// A linear problem: residuals b − A·x.
struct Linear {
    a: DMatrix<f64>,
    b: DVector<f64>,
}

impl Linear {
    /// Twelve equations in four unknowns, with fixed irregular numbers.
    fn example() -> Self {
        let a = DMatrix::from_fn(12, 4, |i, j| {
            libm::sin((7 * i + 3 * j + 1) as f64) + f64::from(u8::from(i == j))
        });
        let b = DVector::from_fn(12, |i, _| libm::cos((5 * i + 2) as f64));
        Self { a, b }
    }

    fn solve(&self, x0: &[f64], options: &Options) -> Summary {
        let mut evaluate = |x: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>| {
            *r = &self.b - &self.a * DVector::from_column_slice(x);
            if let Some(j) = j {
                j.copy_from(&-&self.a);
            }
        };
        minimize(&mut evaluate, self.b.len(), x0, options, &mut go_on)
    }
}

/// Tolerance: rounding of a well-conditioned problem of order one.
const ROUNDING: f64 = 1e-12;

#[test]
fn a_linear_problem_is_solved_in_one_step_as_by_the_normal_equations() {
    let problem = Linear::example();
    let summary = problem.solve(&[0.0; 4], &Options::default());
    let normal = problem.a.transpose() * &problem.a;
    let expected = normal.try_inverse().expect("full rank") * problem.a.transpose() * &problem.b;
    assert!((DVector::from_vec(summary.x.clone()) - &expected).amax() < ROUNDING);
    assert!(
        summary.convergence[1] - summary.cost < ROUNDING,
        "the first step does it: {:?}",
        summary.convergence
    );
    assert!(summary.termination.converged());
    assert!((summary.cost - (&problem.b - &problem.a * expected).norm_squared()).abs() < ROUNDING);
}

#[test]
fn a_parameter_that_nothing_depends_on_stays_and_one_seen_twice_is_shared() {
    // Column 1 is zero; columns 2 and 3 are the same: rank 2 of 4.
    let mut problem = Linear::example();
    problem.a.column_mut(1).fill(0.0);
    let twin = problem.a.column(2).clone_owned();
    problem.a.set_column(3, &twin);
    let summary = problem.solve(&[0.5, 0.25, 0.0, 0.0], &Options::default());
    assert!(summary.termination.converged(), "{:?}", summary.termination);
    assert!((summary.x[1] - 0.25).abs() < ROUNDING, "{:?}", summary.x);
    assert!(
        (summary.x[2] - summary.x[3]).abs() < ROUNDING,
        "the shortest of all equally good steps: {:?}",
        summary.x
    );
    let svd = problem
        .a
        .clone()
        .try_svd(true, true, f64::EPSILON, 1000)
        .expect("finite");
    let best = svd
        .solve(&problem.b, 1e-10)
        .expect("both sides were asked for");
    assert!((summary.cost - (&problem.b - &problem.a * best).norm_squared()).abs() < ROUNDING);
}

#[test]
fn fewer_residuals_than_parameters_are_made_zero() {
    let full = Linear::example();
    let problem = Linear {
        a: full.a.rows(0, 3).clone_owned(),
        b: full.b.rows(0, 3).clone_owned(),
    };
    let summary = problem.solve(&[0.0; 4], &Options::default());
    assert!(summary.cost < ROUNDING * ROUNDING, "{}", summary.cost);
    assert!(summary.termination.converged());
}

#[test]
fn the_unit_of_a_parameter_changes_nothing() {
    // With parameters in units of 2^-20 every power of two is exact, so even the path is the same.
    const UNIT: f64 = 1_048_576.0;
    let problem = problems()
        .into_iter()
        .find(|problem| problem.name == "Thurber")
        .expect("it is in the file");
    let plain = solve(&problem, &problem.starts[1], &Options::default());
    let mut in_units = |b: &[f64], r: &mut DVector<f64>, mut j: Option<&mut DMatrix<f64>>| {
        let b: Vec<f64> = b.iter().map(|b| b / UNIT).collect();
        problem.evaluate(&b, r, j.as_deref_mut());
        if let Some(j) = j {
            *j /= UNIT;
        }
    };
    let start: Vec<f64> = problem.starts[1].iter().map(|b| b * UNIT).collect();
    let scaled = minimize(
        &mut in_units,
        problem.data.len(),
        &start,
        &Options::default(),
        &mut go_on,
    );
    assert_eq!(scaled.convergence, plain.convergence);
    assert_eq!(
        scaled.x.iter().map(|x| x / UNIT).collect::<Vec<_>>(),
        plain.x
    );
}

/// Residual ln(x): not a number left of zero, and the first step from 8 leads there.
fn logarithm(x: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>) {
    r[0] = if x[0] > 0.0 {
        libm::log(x[0])
    } else {
        f64::NAN
    };
    if let Some(j) = j {
        j[(0, 0)] = 1.0 / x[0];
    }
}

#[test]
fn a_step_to_where_the_residuals_are_not_finite_is_rejected() {
    let mut wandered = false;
    let mut problem = |x: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>| {
        wandered |= x[0] <= 0.0;
        logarithm(x, r, j);
    };
    let summary = minimize(&mut problem, 1, &[8.0], &Options::default(), &mut go_on);
    assert!((summary.x[0] - 1.0).abs() < ROUNDING, "{summary:?}");
    assert!(summary.convergence.is_sorted_by(|a, b| a >= b));
    assert!(wandered, "the test must visit the forbidden side");
}

#[test]
fn a_start_or_a_jacobian_that_is_not_finite_ends_the_search() {
    let start = minimize(&mut logarithm, 1, &[-1.0], &Options::default(), &mut go_on);
    assert_eq!(
        (start.termination, start.cost, start.n_iterations),
        (Termination::NotFinite, f64::INFINITY, 0)
    );
    let mut root = |x: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>| {
        r[0] = 1.0 + x[0].sqrt();
        if let Some(j) = j {
            j[(0, 0)] = 0.5 / x[0].sqrt();
        }
    };
    let jacobian = minimize(&mut root, 1, &[0.0], &Options::default(), &mut go_on);
    assert_eq!(
        (jacobian.termination, jacobian.x, jacobian.cost),
        (Termination::NotFinite, vec![0.0], 1.0)
    );
}

#[test]
fn the_search_stops_at_a_cost_at_a_limit_and_when_told_to() {
    let problem = problems()
        .into_iter()
        .find(|problem| problem.name == "Thurber")
        .expect("it is in the file");
    let start = &problem.starts[0];
    let reached = solve(
        &problem,
        start,
        &Options {
            stop_at_cost: Some(1e4),
            ..Options::default()
        },
    );
    assert_eq!(reached.termination, Termination::CostReached);
    assert!(reached.cost <= 1e4 && reached.convergence[reached.n_iterations - 1] > 1e4);
    let limited = solve(
        &problem,
        start,
        &Options {
            max_iterations: 3,
            ..Options::default()
        },
    );
    assert_eq!(
        (
            limited.termination,
            limited.n_iterations,
            limited.convergence.len()
        ),
        (Termination::IterationLimit, 3, 4)
    );
    assert!(!limited.termination.converged());

    let mut evaluate =
        |b: &[f64], r: &mut DVector<f64>, j: Option<&mut DMatrix<f64>>| problem.evaluate(b, r, j);
    let mut reported = Vec::new();
    let mut monitor = |iteration: Iteration| {
        reported.push((iteration.iteration, iteration.cost));
        if iteration.iteration == 4 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let stopped = minimize(
        &mut evaluate,
        problem.data.len(),
        start,
        &Options::default(),
        &mut monitor,
    );
    assert_eq!(
        (stopped.termination, stopped.n_iterations),
        (Termination::Stopped, 4)
    );
    assert_eq!(
        reported,
        stopped
            .convergence
            .iter()
            .copied()
            .enumerate()
            .collect::<Vec<_>>()
    );
}

#[test]
fn the_summary_describes_the_point_it_returns() {
    let problem = problems()
        .into_iter()
        .find(|problem| problem.name == "Hahn1")
        .expect("it is in the file");
    let summary = solve(&problem, &problem.starts[0], &Options::default());
    let mut residuals = DVector::zeros(problem.data.len());
    problem.evaluate(&summary.x, &mut residuals, None);
    assert_eq!(summary.residuals, residuals);
    assert!(digits(residuals.norm_squared(), summary.cost) > 10.0);
    assert_eq!(summary.convergence.last(), Some(&summary.cost));
    assert_eq!(summary.convergence.len(), summary.n_iterations + 1);
    assert_eq!(
        summary.n_evaluations,
        1 + summary.n_iterations + summary.n_jacobians
    );
}
