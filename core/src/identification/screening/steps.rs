//! Steps in the residuals along the measuring order: something moved during the measurement.
//!
//! If a target slips before the k-th point, all later residuals of that target gain R·δ, with R the flange's orientation and δ the shift in
//! the flange frame. If the base (or the instrument) moves, all later residuals gain a rigid motion. Let y be the residuals of a
//! least-squares fit, P the projection out of the changes that its parameters can make, and B the columns of such a motion. The fit would
//! then improve by g = yᵀB·(BᵀPB)⁻¹·Bᵀy (the score test, which for a linear model is also the likelihood ratio). A robot's errors are a
//! smooth function of its joints, so on a path through the workspace they look like steps. Everything is therefore computed with the
//! inverse of V = I + λ·Φ·Φᵀ. The features Φ are those of [`misfit`](crate::identification::statistics::misfit), and λ is their share in
//! the residuals. The largest g must pass four tests:
//!
//! - F = (g/d) / (left/freedom) is larger than noise makes it at any place (Bonferroni). Points of one configuration may have correlated
//!   errors: F is divided by the ratio of the variation of their sums to that of independent points;
//! - g is larger than after random permutations of the configurations. This holds for any distribution of the residuals;
//! - the points on the smaller side have moved by twice the scatter of all points. Effects that no feature describes are not larger than
//!   that;
//! - g is still significant if a drift of the base ([`drift`](crate::identification::screening::drift)) is fitted too: a ramp, a warm-up, and
//!   a random walk whose variance is estimated together with the step.

use crate::identification::screening::columns::Columns;
use crate::identification::screening::drift::{Beside, beside_drift};
use crate::identification::screening::outliers::Linearised;
use crate::identification::screening::row_order::holds_in_random_orders;
use crate::identification::screening::whitening::Whitened;
use crate::identification::statistics::distributions::f_tail;
use crate::solvers::watch::Watch;
use nalgebra::{Const, DMatrix, Dyn, OMatrix, SMatrix, SVector, Vector3};

/// Probability of reporting a step if there is none, over the whole order and all kinds. It is a fifth of the required value, because there are
/// several rounds, and residuals are not quite normal.
const FALSE_ALARMS: f64 = 0.002;
/// Gains with a smaller relative difference are equal: they belong to the same points.
const SAME_GAIN: f64 = 1e-9;
/// A change is tried if the fit leaves at least this share of it visible; a smaller share is rounding.
const MIN_VISIBLE_SHARE: f64 = 1e-3;
/// Minimum ratio of two mean squares: the motion of the points on the smaller side, and the remaining residuals. The points must have moved
/// by twice the scatter. Simulated and measured sets without motion reach 2.7; a slip of 2 mm in noise of 0.3 mm reaches 7.
const SMALLEST_EFFECT: f64 = 4.0;
/// Minimum number of points on either side of a motion of the base: twelve coordinates for its six parameters. With three points, only
/// three coordinates would be left to distinguish the motion from outliers.
const MIN_BASE_POINTS: usize = 4;
/// Minimum number of points on either side of a shift of the base without rotation. Two points that move alike are common in noise with
/// heavy tails.
const MIN_SHIFTED_POINTS: usize = 3;
/// Minimum number of points on either side of a slip of a target. A single point is treated separately.
const MIN_TARGET_POINTS: usize = 2;

/// The part that moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moved {
    /// A target on the flange.
    Target(usize),
    /// The base, or the instrument.
    Base,
}

/// A step: something moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The part that moved.
    pub moved: Moved,
    /// First point after the step (of that target).
    pub first: usize,
    /// Displacement, mm: of a target in the flange frame, of the base in the measuring frame. A motion of the instrument appears as the
    /// opposite motion of the base.
    pub shift_mm: Vector3<f64>,
    /// Rotation, rad: of the base about [`Columns::centre`] in the measuring frame, of a target of poses in its own frame.
    pub turn_rad: Vector3<f64>,
    /// True if the step separates only one point at an end. It may be an outlier, and is treated as one.
    pub is_one_point: bool,
}

/// A motion before one point: of one target, of all targets at once, or of the base.
#[derive(Clone, Debug, PartialEq)]
pub struct Jump {
    /// The first point after it.
    pub first: usize,
    /// The target whose points alone have moved; `None` if all points have.
    pub target: Option<usize>,
    /// Number of points on its smaller side (of that target).
    pub n_minor: usize,
    /// A step of each target, or one of the base.
    pub steps: Vec<Step>,
}

/// The kind of change that is tried.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// One target.
    Target(usize),
    /// All targets at once, each by its own vector: the tool was hit.
    AllTargets,
    /// The base, or the instrument: six numbers.
    Base,
    /// A shift of the base without rotation: three parameters, which need fewer rows.
    BaseShift,
}

/// The points of a measurement in measuring order, with their fit.
pub struct Campaign<'a> {
    /// The fit to the points of `order`, in the same order.
    pub linear: &'a Linearised,
    /// The features of the misfit at these points.
    pub features: &'a DMatrix<f64>,
    /// The whitened fit and features.
    pub problem: &'a Whitened,
    /// Effects of motions, for every point of the set.
    pub columns: &'a Columns,
    /// The fitted points in measuring order.
    pub order: &'a [usize],
    /// Target of every point of the set.
    pub targets: &'a [usize],
    /// Configuration of every point of the set.
    pub clusters: &'a [usize],
    /// Lower limit of a coordinate's standard deviation, mm.
    pub least_scale_mm: f64,
    /// Asked between the random orders whether to stop.
    pub watch: &'a Watch<'a>,
}

/// A change that was tried.
#[derive(Clone, Debug)]
struct Tried {
    kind: Kind,
    /// Index in `order` of the first point after the change.
    place: usize,
    n_minor: usize,
    gain: f64,
    n_numbers: usize,
    solution: Vec<f64>,
}

impl Campaign<'_> {
    /// The most significant jump that passes all four tests. A single point at an end is returned like any other: one point cannot show whether it
    /// slipped or is an outlier.
    pub fn jump(&self) -> Option<Jump> {
        let n = self.order.len();
        let left = self.problem.residuals.norm_squared();
        let least_variance = self.least_scale_mm * self.least_scale_mm;
        if left <= n as f64 * least_variance {
            return None;
        }
        let places: Vec<usize> = (0..n).collect();
        let tried = self.all_changes(&places);
        let n_tried = tried.len();
        let rows = 3.0 * n as f64;
        // Of all kinds of steps, the one that explains most for its number of unknowns [Schwarz 1978].
        let criterion = |t: &Tried| {
            rows * libm::log((left - t.gain).max(f64::MIN_POSITIVE))
                + t.n_numbers as f64 * libm::log(rows)
        };
        let best = tried
            .into_iter()
            .min_by(|a, b| criterion(a).total_cmp(&criterion(b)))?;
        let freedom = rows - (self.problem.n_fitted + best.n_numbers) as f64;
        let rest = left - best.gain;
        if freedom < 3.0 || best.gain / (best.n_minor as f64) < SMALLEST_EFFECT * rest / n as f64 {
            return None;
        }
        let f = best.gain
            / best.n_numbers as f64
            / (rest / freedom).max(least_variance)
            / self.design_effect();
        if f_tail(f, best.n_numbers as f64, freedom) * n_tried as f64 > FALSE_ALARMS
            || !self.stands_out(&best)
            || !self.is_no_drift(&best, n_tried)
        {
            return None;
        }
        let first = self.order[best.place];
        let step = |moved, first, (shift_mm, turn_rad)| Step {
            moved,
            first,
            shift_mm,
            turn_rad,
            is_one_point: best.n_minor == 1,
        };
        let shift = |vector: &[f64]| (Vector3::from_column_slice(vector), Vector3::zeros());
        let of_target = |(target, vector): (usize, &[f64])| {
            let mut after = self.order[best.place..].iter().copied();
            let first = after.find(|point| self.targets[*point] == target)?;
            Some(step(Moved::Target(target), first, shift(vector)))
        };
        let of_targets = |from: usize| -> Vec<Step> {
            let shifts = (from..).zip(best.solution.chunks(3));
            shifts.filter_map(of_target).collect()
        };
        let (target, steps) = match best.kind {
            Kind::Target(target) => (Some(target), of_targets(target)),
            Kind::AllTargets => (None, of_targets(0)),
            Kind::Base => {
                let motion = self.columns.motion(&best.solution);
                (None, vec![step(Moved::Base, first, motion)])
            }
            Kind::BaseShift => {
                let shift = shift(&best.solution);
                (None, vec![step(Moved::Base, first, shift)])
            }
        };
        Some(Jump {
            first,
            target,
            n_minor: best.n_minor,
            steps,
        })
    }

    /// Tries changes of all targets at once, for up to four targets.
    fn changes_of_all_targets(&self, places: &[usize], tried: &mut Vec<Tried>) {
        match self.n_targets() {
            2 => self.changes_of_targets::<6>(places, tried),
            3 => self.changes_of_targets::<9>(places, tried),
            4 => self.changes_of_targets::<12>(places, tried),
            _ => {}
        }
    }

    /// D is three times the number of targets.
    fn changes_of_targets<const D: usize>(&self, places: &[usize], tried: &mut Vec<Tried>) {
        let block = |point: usize| {
            let mut block = SMatrix::<f64, 3, D>::zeros();
            block
                .fixed_view_mut::<3, 3>(0, 3 * self.targets[point])
                .copy_from(&self.columns.target[point]);
            block
        };
        let fewest = MIN_TARGET_POINTS * D / 3;
        self.changes(Kind::AllTargets, places, (fewest, false), block, tried);
    }

    fn n_targets(&self) -> usize {
        self.targets.iter().map(|t| t + 1).max().unwrap_or(0)
    }

    fn all_changes(&self, places: &[usize]) -> Vec<Tried> {
        let mut tried = Vec::new();
        for target in 0..self.n_targets() {
            let members: Vec<usize> = places
                .iter()
                .copied()
                .filter(|p| self.targets[self.order[*p]] == target)
                .collect();
            self.changes(
                Kind::Target(target),
                &members,
                (MIN_TARGET_POINTS, true),
                |point| self.columns.target[point],
                &mut tried,
            );
        }
        self.changes_of_base(places, &mut tried);
        self.changes_of_base_without_turn(places, &mut tried);
        self.changes_of_all_targets(places, &mut tried);
        tried
    }

    fn changes_of_base(&self, places: &[usize], tried: &mut Vec<Tried>) {
        let fewest = (MIN_BASE_POINTS, false);
        let block = |point: usize| self.columns.base[point];
        self.changes(Kind::Base, places, fewest, block, tried);
    }

    fn changes_of_base_without_turn(&self, places: &[usize], tried: &mut Vec<Tried>) {
        let fewest = (MIN_SHIFTED_POINTS, false);
        let block = |point: usize| self.columns.base_shift(point);
        self.changes(Kind::BaseShift, places, fewest, block, tried);
    }

    /// Tries a change before each of the `members` (indices into the order), in measuring order. Each side must have at least `fewest` of
    /// them, or a single one if `lone` is true.
    fn changes<const D: usize>(
        &self,
        kind: Kind,
        members: &[usize],
        (fewest, lone): (usize, bool),
        block: impl Fn(usize) -> SMatrix<f64, 3, D>,
        tried: &mut Vec<Tried>,
    ) {
        let Whitened { scores, basis, .. } = self.problem;
        let mut score = SVector::<f64, D>::zeros();
        let mut square = SMatrix::<f64, D, D>::zeros();
        let mut fitted = OMatrix::<f64, Const<D>, Dyn>::zeros(basis.ncols());
        for (k, place) in members.iter().enumerate().rev() {
            let b = block(self.order[*place]);
            score += b.tr_mul(&scores.fixed_rows::<3>(3 * place));
            square += b.tr_mul(&b);
            fitted += b.transpose() * basis.fixed_rows::<3>(3 * place);
            let n_minor = k.min(members.len() - k);
            let is_lone = n_minor == 1 && lone;
            if n_minor < fewest && !is_lone {
                continue;
            }
            let Some(factor) = (square - &fitted * fitted.transpose()).cholesky() else {
                continue;
            };
            let smallest = (0..D)
                .map(|i| factor.l_dirty()[(i, i)])
                .fold(f64::INFINITY, f64::min);
            if smallest * smallest < MIN_VISIBLE_SHARE * n_minor as f64 {
                continue;
            }
            let solution = factor.solve(&score);
            let gain = solution.dot(&score);
            tried.push(Tried {
                kind,
                place: *place,
                n_minor,
                gain,
                n_numbers: D,
                solution: solution.iter().copied().collect(),
            });
        }
    }

    fn design_effect(&self) -> f64 {
        let clusters = self.order.iter().map(|point| self.clusters[*point]);
        self.problem.design_effect(clusters)
    }

    /// True if the step is still significant when a drift of the base is fitted too.
    fn is_no_drift(&self, best: &Tried, n_tried: usize) -> bool {
        let roots: Vec<f64> = self
            .order
            .iter()
            .map(|point| self.columns.base[*point][(0, 0)])
            .collect();
        let mut of_step = DMatrix::zeros(3 * self.order.len(), best.n_numbers);
        for (place, point) in self.order.iter().enumerate().skip(best.place) {
            let target = self.targets[*point];
            let rows = 3 * place;
            match best.kind {
                Kind::Base => of_step
                    .fixed_view_mut::<3, 6>(rows, 0)
                    .copy_from(&self.columns.base[*point]),
                Kind::BaseShift => of_step
                    .fixed_view_mut::<3, 3>(rows, 0)
                    .copy_from(&self.columns.base_shift(*point)),
                Kind::Target(moved) if moved != target => {}
                Kind::Target(_) => of_step
                    .fixed_view_mut::<3, 3>(rows, 0)
                    .copy_from(&self.columns.target[*point]),
                Kind::AllTargets => of_step
                    .fixed_view_mut::<3, 3>(rows, 3 * target)
                    .copy_from(&self.columns.target[*point]),
            }
        }
        let of_points = self.order.iter().map(|point| *self.columns.growth(*point));
        let growth: Vec<Vector3<f64>> = of_points.collect();
        let drifting = (roots.as_slice(), growth.as_slice());
        let beside = beside_drift(self.linear, self.features, drifting, &of_step, self.watch);
        let Some(Beside {
            gain,
            rest,
            freedom,
        }) = beside
        else {
            return false;
        };
        let least_variance = self.least_scale_mm * self.least_scale_mm;
        let variance = (rest / freedom).max(least_variance) * self.design_effect();
        let n = best.n_numbers as f64;
        f_tail(gain / n / variance, n, freedom) * n_tried as f64 <= FALSE_ALARMS
    }

    /// True if the gain is larger than that of every change of its kind in random orders of the configurations.
    fn stands_out(&self, best: &Tried) -> bool {
        let mut order: Vec<Vec<usize>> = Vec::new();
        let mut at = std::collections::BTreeMap::new();
        for (place, point) in self.order.iter().enumerate() {
            let block = *at.entry(self.clusters[*point]).or_insert_with(|| {
                order.push(vec![]);
                order.len() - 1
            });
            order[block].push(place);
        }
        let alone = best.n_minor == 1;
        holds_in_random_orders(order, self.watch, |places| {
            let mut tried = Vec::new();
            match best.kind {
                // For a single point, only its position in the order is random, and any other point could be there.
                Kind::Target(_) if alone => return true,
                Kind::Target(target) => {
                    let members: Vec<usize> = places
                        .iter()
                        .copied()
                        .filter(|p| self.targets[self.order[*p]] == target)
                        .collect();
                    self.changes(
                        best.kind,
                        &members,
                        (MIN_TARGET_POINTS, false),
                        |point| self.columns.target[point],
                        &mut tried,
                    );
                }
                Kind::AllTargets => self.changes_of_all_targets(places, &mut tried),
                Kind::Base => self.changes_of_base(places, &mut tried),
                Kind::BaseShift => self.changes_of_base_without_turn(places, &mut tried),
            }
            // An order that divides the points in the same way gives the same gain and does not count.
            tried
                .iter()
                .all(|t| t.gain <= best.gain * (1.0 + SAME_GAIN))
        })
    }
}
