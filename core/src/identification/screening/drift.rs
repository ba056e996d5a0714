//! Drift of the base or of the instrument during the measurement: all points move by a vector that grows with time.
//!
//! Time runs from 0 at the first point to 1 at the last one, in measuring order. Three models are compared by their gain and their number
//! of parameters [Schwarz 1978]: a ramp d·t; a warm-up d·(1 − exp(−t/τ)), relative to its value at t = 1; and a random walk, which is a sum
//! of the first functions of Brownian motion [Karhunen & Loève] with its most probable variance. As for steps
//! ([`steps`](crate::identification::screening::steps)), everything is computed with the inverse of V = I + λ·Φ·Φᵀ of the robot's misfit. A
//! drift is reported on two conditions: noise gives as large a gain with a probability below [`FALSE_ALARMS`], and the gain is larger than
//! after random permutations of the configurations.
//!
//! Poses that were visited several times show a drift without a model of the robot: only differences within a pose are used.

use crate::identification::screening::outliers::Linearised;
use crate::identification::screening::row_order::{
    OrderedPoints, by_configuration, holds_in_random_orders, visits,
};
use crate::identification::screening::whitening::{Gain, Whitened, Whitener};
use crate::identification::statistics::distributions::{chi_square_tail, f_tail};
use crate::identification::statistics::variance::{RandomEffect, misfit_ratio, random_effect};
use crate::solvers::products::side_by_side;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, Vector3};
use std::collections::BTreeMap;

/// Probability of reporting a drift if there is none. It is just below the required value. With a smaller one, drifts of twice the noise
/// that show in the visits of one pose would not be reported.
const FALSE_ALARMS: f64 = 0.008;
/// Number of tests (models and repeated poses) that share the probability of a false alarm.
const N_TESTS: f64 = 4.0;
/// Time constants of a warm-up that are tried, as shares of the session.
const TIME_CONSTANTS: [f64; 4] = [0.05, 0.1, 0.2, 0.4];
/// A ramp is the warm-up with this very long time constant. A ramp has one parameter less.
const RAMP_TIME_CONSTANT: f64 = 1e6;
/// Maximum number of functions of the random walk, each with a shorter period than the one before; minimum number of points per function.
const WALK_FUNCTIONS: usize = 20;
const POINTS_PER_FUNCTION: usize = 4;
/// Maximum number of points that are used, evenly selected.
const MAX_POINTS: usize = 3_000;
/// A drift below this share of the noise of a coordinate is not reported, however significant it is.
const SMALLEST_EFFECT: f64 = 0.25;
/// Minimum degrees of freedom for a conclusion.
const MIN_FREE: f64 = 12.0;

/// Course of a drift over time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Course {
    /// At the same rate during the whole session.
    Steady,
    /// Fast at first, then slower.
    WarmUp {
        /// Time after which 63 % of the drift is done, as a share of the session.
        time_constant: f64,
    },
    /// Back and forth, as a random walk.
    Wandering,
}

impl Course {
    fn time_constant(self) -> f64 {
        match self {
            Self::WarmUp { time_constant } => time_constant,
            Self::Steady | Self::Wandering => RAMP_TIME_CONSTANT,
        }
    }
}

/// A drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Its course over time.
    pub course: Course,
    /// Movement of the measured positions from the first point to the last one, in the measuring frame, mm.
    pub vector_mm: Vector3<f64>,
    /// Standard deviation of the movement along its own direction, mm.
    pub std_mm: f64,
    /// Number of rows of poses that were visited several times, and the movement that they show; `None` if there are too few.
    pub by_repeats_mm: Option<(usize, Vector3<f64>)>,
}

/// Time of each of n points.
fn times(n: usize) -> Vec<f64> {
    let last = n.saturating_sub(1).max(1) as f64;
    (0..n).map(|i| i as f64 / last).collect()
}

/// Columns of a shift along each axis, as a function of time, 3·N × 3.
fn shifts(roots: &[f64], times: &[f64], of_time: impl Fn(f64) -> f64) -> DMatrix<f64> {
    let mut columns = DMatrix::zeros(3 * roots.len(), 3);
    for (i, (root, t)) in roots.iter().zip(times).enumerate() {
        let shift = root * of_time(*t);
        (0..3).for_each(|axis| columns[(3 * i + axis, axis)] = shift);
    }
    columns
}

/// Share of a warm-up that is complete at time t, relative to t = 1.
fn done(t: f64, time_constant: f64) -> f64 {
    libm::expm1(-t / time_constant) / libm::expm1(-1.0 / time_constant)
}

/// Column of links that grow as they warm up, relative to the largest effect; 3·N × 1.
fn grown(growth: &[Vector3<f64>], times: &[f64], time_constant: f64) -> DMatrix<f64> {
    let largest = growth.iter().map(Vector3::norm).fold(0.0, f64::max);
    let mut column = DMatrix::zeros(3 * growth.len(), 1);
    for (i, (effect, t)) in growth.iter().zip(times).enumerate() {
        let effect = effect * (done(*t, time_constant) / largest.max(f64::MIN_POSITIVE));
        column.fixed_view_mut::<3, 1>(3 * i, 0).copy_from(&effect);
    }
    column
}

/// Columns of a random walk of standard deviation 1 mm at t = 1.
fn walk(roots: &[f64], times: &[f64]) -> DMatrix<f64> {
    let n_functions = (roots.len() / POINTS_PER_FUNCTION).clamp(1, WALK_FUNCTIONS);
    let mut columns = DMatrix::zeros(3 * roots.len(), 3 * n_functions);
    for k in 0..n_functions {
        let frequency = (k as f64 + 0.5) * std::f64::consts::PI;
        let of_time = |t: f64| std::f64::consts::SQRT_2 * libm::sin(frequency * t) / frequency;
        columns
            .columns_mut(3 * k, 3)
            .copy_from(&shifts(roots, times, of_time));
    }
    columns
}

/// A random walk as a random effect, in addition to the misfit.
fn walk_effect(
    linear: &Linearised,
    features: &DMatrix<f64>,
    misfit: f64,
    walk: &DMatrix<f64>,
) -> Option<RandomEffect> {
    let whitener = Whitener::new(features, misfit)?;
    let q = whitener.whitened(&linear.basis).qr().q();
    let y = whitener.whitened_column(&linear.residuals);
    random_effect(&y, &q, &whitener.whitened(walk))
}

/// The whitened problem of `linear`. The variances of misfit and random walk are those estimated with all columns of `all`.
fn with_random_walk(
    linear: &Linearised,
    all: &Linearised,
    features: &DMatrix<f64>,
    roots: &[f64],
    watch: &Watch<'_>,
) -> Option<Whitened> {
    let misfit = misfit_ratio(&all.residuals, &all.basis, features);
    let walk = walk(roots, &times(roots.len()));
    watch.goes_on().then_some(())?;
    let of_walk = walk_effect(all, features, misfit, &walk)?.kept_ratio();
    let random = side_by_side(&[&(features * misfit.sqrt()), &(walk * of_walk.sqrt())]);
    Whitened::with_ratio(linear, &random, 1.0, watch)
}

/// Gain of a change in addition to a drift.
pub struct Beside {
    /// Reduction of the whitened sum of squares by the change, mm².
    pub gain: f64,
    /// Whitened sum of squares that is left with the change, mm².
    pub rest: f64,
    /// Degrees of freedom of the rest.
    pub freedom: f64,
}

/// Gain of the columns of a change if a drift is fitted too: a ramp, the best warm-up, and a random walk whose variance is estimated
/// together with the change. Base and links may drift; `growth` is the effect of links that each grow in proportion to their length. `None`
/// if nothing is left of the columns.
pub fn beside_drift(
    linear: &Linearised,
    features: &DMatrix<f64>,
    (roots, growth): (&[f64], &[Vector3<f64>]),
    change: &DMatrix<f64>,
    watch: &Watch<'_>,
) -> Option<Beside> {
    let times = times(roots.len());
    let course = |time_constant: f64| {
        let of_base = shifts(roots, &times, |t| done(t, time_constant));
        side_by_side(&[&of_base, &grown(growth, &times, time_constant)])
    };
    let ramp = course(RAMP_TIME_CONSTANT);
    let problem = Whitened::new(linear, features, watch);
    let warm_up = |time_constant: f64| {
        let smooth = side_by_side(&[&ramp, &course(time_constant)]);
        Some((problem.fitted(&smooth)?.gain, smooth))
    };
    let (_, smooth) = TIME_CONSTANTS
        .into_iter()
        .filter_map(warm_up)
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let all = linear.with(&side_by_side(&[&smooth, change]));
    let problem = with_random_walk(&linear.with(&smooth), &all, features, roots, watch)?;
    let gain = problem.fitted(change)?.gain;
    let freedom = (3 * roots.len()) as f64 - (problem.n_fitted + change.ncols()) as f64;
    (freedom >= 1.0).then_some(Beside {
        gain,
        rest: (problem.residuals.norm_squared() - gain).max(0.0),
        freedom,
    })
}

/// A fitted model of drift.
struct Fitted {
    course: Course,
    gain: Gain,
    /// Probability that noise gives a gain at least as large.
    probability: f64,
    /// Schwarz's criterion; smaller is better [Schwarz 1978].
    criterion: f64,
}

/// Drift from the differences within poses that were visited several times.
struct ByRepeats {
    n_rows: usize,
    vector_mm: Vector3<f64>,
    probability: f64,
}

/// A target of a pose at one visit: mean time, mean residual and number of rows.
struct Visit {
    time: f64,
    residual: Vector3<f64>,
    n_rows: usize,
}

impl OrderedPoints<'_> {
    /// The drift of a session; `None` if none is significant.
    pub fn drift(&self) -> Option<Drift> {
        let n = self.roots.len();
        let every = n.div_ceil(MAX_POINTS).max(1);
        match every {
            1 => self.drift_of_all(),
            _ => {
                let taken: Vec<usize> = (0..n).step_by(every).collect();
                self.of(&taken).drift_of_all()
            }
        }
    }

    fn drift_of_all(&self) -> Option<Drift> {
        if !self.watch.goes_on() {
            return None;
        }
        let times = times(self.roots.len());
        let problem = Whitened::new(&self.linear, &self.features, self.watch);
        let left = problem.residuals.norm_squared();
        let rows = (3 * self.roots.len()) as f64;
        let freedom = rows - problem.n_fitted as f64 - 4.0;
        if freedom < MIN_FREE || left <= rows * self.linear.rounding_mm * self.linear.rounding_mm {
            return None;
        }
        let design = problem.design_effect(self.clusters.iter().copied());
        let shape = |time_constant: f64| {
            let gain = problem.fitted(&shifts(&self.roots, &times, |t| done(t, time_constant)))?;
            let variance = (left - gain.gain).max(f64::MIN_POSITIVE) / freedom * design;
            let is_ramp = time_constant == RAMP_TIME_CONSTANT;
            let n_numbers = if is_ramp { 3.0 } else { 4.0 };
            let n_tried = if is_ramp {
                1.0
            } else {
                TIME_CONSTANTS.len() as f64
            };
            Some(Fitted {
                course: match is_ramp {
                    true => Course::Steady,
                    false => Course::WarmUp { time_constant },
                },
                probability: n_tried * f_tail(gain.gain / 3.0 / variance, 3.0, freedom),
                criterion: rows * libm::log((left - gain.gain).max(f64::MIN_POSITIVE)) / design
                    + n_numbers * libm::log(rows),
                gain,
            })
        };
        let shapes = [RAMP_TIME_CONSTANT].into_iter().chain(TIME_CONSTANTS);
        let best = shapes
            .filter_map(shape)
            .min_by(|a, b| a.criterion.total_cmp(&b.criterion))?;
        let misfit = misfit_ratio(&self.linear.residuals, &self.linear.basis, &self.features);
        let walk = walk(&self.roots, &times);
        let of_walk = walk_effect(&self.linear, &self.features, misfit, &walk);
        let likelihood_ratio = of_walk.map_or(0.0, |effect| effect.likelihood_ratio) / design;
        let wandering = rows * libm::log(left.max(f64::MIN_POSITIVE)) / design - likelihood_ratio
            + libm::log(rows);
        // Without a random walk, the variance is at its bound [Self & Liang 1987].
        let by_chance = 0.5 * chi_square_tail(likelihood_ratio, 1.0);
        let repeats = self.drift_by_repeats(&times);
        let of_repeats = repeats.as_ref().map_or(1.0, |repeats| repeats.probability);
        let limit = FALSE_ALARMS / N_TESTS;
        let is_shown = best.probability <= limit || of_repeats <= limit;
        let noise_mm = (left / freedom).sqrt();
        let vector_mm = Vector3::from_column_slice(best.gain.coefficients.as_slice());
        let is_large = vector_mm.norm() >= SMALLEST_EFFECT * noise_mm;
        if !(is_shown || by_chance <= limit) || !is_large {
            return None;
        }
        let is_sure = || self.drift_stands_out(&problem, &times, &best);
        let is_sure_on_path = || !self.is_path() || self.is_beside_walk(&times, &best, limit);
        if of_repeats > limit && !(is_sure() && is_sure_on_path()) {
            return None;
        }
        let along = vector_mm.normalize();
        let variance = along.dot(&(&best.gain.inverse * along)) * design;
        Some(Drift {
            course: match wandering < best.criterion {
                true => Course::Wandering,
                false => best.course,
            },
            vector_mm,
            std_mm: noise_mm * variance.max(0.0).sqrt(),
            by_repeats_mm: repeats.map(|repeats| (repeats.n_rows, repeats.vector_mm)),
        })
    }

    /// True if the configurations were measured along a path: from point to point, the joints move less than in random orders.
    fn is_path(&self) -> bool {
        let n = self.q_rad.len() as f64;
        let n_joints = self.q_rad.first().map_or(0, |q| q.len());
        let variance = |joint: usize| {
            let mean = self.q_rad.iter().map(|q| q[joint]).sum::<f64>() / n;
            let square = |q: &&[f64]| (q[joint] - mean) * (q[joint] - mean);
            (self.q_rad.iter().map(square).sum::<f64>() / n).max(f64::MIN_POSITIVE)
        };
        let variances: Vec<f64> = (0..n_joints).map(variance).collect();
        let moved = |places: &[usize]| -> f64 {
            let of_joint = |pair: &[usize], joint: usize| {
                let change = self.q_rad[pair[1]][joint] - self.q_rad[pair[0]][joint];
                change * change / variances[joint]
            };
            let pairs = places.windows(2);
            pairs
                .map(|pair| (0..n_joints).map(|j| of_joint(pair, j)).sum::<f64>())
                .sum()
        };
        let as_measured = moved(&visits(&self.clusters).concat());
        holds_in_random_orders(by_configuration(&self.clusters), self.watch, |places| {
            as_measured < moved(places)
        })
    }

    /// True if a ramp or a warm-up is significant when a random walk is estimated together with it. Along a path, effects that links cannot
    /// describe change with time, and so look like a random walk.
    fn is_beside_walk(&self, times: &[f64], best: &Fitted, limit: f64) -> bool {
        let columns = shifts(&self.roots, times, |t| done(t, best.course.time_constant()));
        let all = self.linear.with(&columns);
        let probability = || {
            let (linear, features) = (&self.linear, &self.features);
            let problem = with_random_walk(linear, &all, features, &self.roots, self.watch)?;
            let gain = problem.fitted(&columns)?.gain;
            let freedom = columns.nrows() as f64 - problem.n_fitted as f64 - 3.0;
            let variance = (problem.residuals.norm_squared() - gain) / freedom
                * problem.design_effect(self.clusters.iter().copied());
            Some(f_tail(gain / 3.0 / variance, 3.0, freedom))
        };
        probability().is_some_and(|probability| probability <= limit)
    }

    /// True if the gain is larger than in random orders of the configurations.
    fn drift_stands_out(&self, problem: &Whitened, times: &[f64], best: &Fitted) -> bool {
        let time_constant = best.course.time_constant();
        holds_in_random_orders(by_configuration(&self.clusters), self.watch, |places| {
            let mut shuffled = vec![0.0; times.len()];
            let pairs = places.iter().zip(times);
            pairs.for_each(|(i, t)| shuffled[*i] = *t);
            let columns = shifts(&self.roots, &shuffled, |t| done(t, time_constant));
            let other = problem.fitted(&columns).map_or(0.0, |gain| gain.gain);
            other <= best.gain.gain
        })
    }

    /// A ramp fitted to the differences within poses of the same target that were visited several times. The points of a target at one
    /// visit count once, because they have common errors. The targets of a visit count once too, because they share the robot's
    /// repeatability.
    fn drift_by_repeats(&self, times: &[f64]) -> Option<ByRepeats> {
        // By configuration and target.
        let mut visited: BTreeMap<usize, BTreeMap<usize, Vec<Visit>>> = BTreeMap::new();
        for visit in visits(&self.clusters) {
            let mut of_targets: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
            for i in &visit {
                of_targets.entry(self.targets[*i]).or_default().push(*i);
            }
            let of_pose = visited.entry(self.clusters[visit[0]]).or_default();
            for (target, rows) in of_targets {
                let n = rows.len() as f64;
                let at = |i: &usize| -> Vector3<f64> {
                    let root = self.roots[*i].max(f64::MIN_POSITIVE);
                    self.linear.residuals.fixed_rows::<3>(3 * i) / root
                };
                let time = rows.iter().map(|i| times[*i]).sum::<f64>() / n;
                let mean = rows.iter().map(at).sum::<Vector3<f64>>() / n;
                let of_target = of_pose.entry(target).or_default();
                of_target.push(Visit {
                    time,
                    residual: mean,
                    n_rows: rows.len(),
                });
            }
        }
        let (mut squares, mut products, mut all) = (0.0, Vector3::zeros(), 0.0);
        let (mut n_rows, mut freedom) = (0, -3.0);
        for of_targets in visited.values() {
            for visits in of_targets.values().filter(|visits| visits.len() > 1) {
                let n = visits.len() as f64;
                let mean_time = visits.iter().map(|v| v.time).sum::<f64>() / n;
                let mean = visits.iter().map(|v| v.residual).sum::<Vector3<f64>>() / n;
                for visit in visits {
                    let (t, y) = (visit.time - mean_time, visit.residual - mean);
                    squares += t * t;
                    products += y * t;
                    all += y.norm_squared();
                    n_rows += visit.n_rows;
                }
                freedom += 3.0 * (n - 1.0) / of_targets.len() as f64;
            }
        }
        if freedom < 3.0 || squares <= 0.0 {
            return None;
        }
        let vector_mm = products / squares;
        let gain = squares * vector_mm.norm_squared();
        let rounding = self.linear.rounding_mm * self.linear.rounding_mm;
        let variance = ((all - gain).max(0.0) / freedom).max(rounding);
        Some(ByRepeats {
            n_rows,
            vector_mm,
            probability: f_tail(gain / 3.0 / variance, 3.0, freedom),
        })
    }
}
