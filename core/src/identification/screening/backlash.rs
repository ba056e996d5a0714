//! Backlash: the arm's position depends on the side from which a joint reached its value.
//! By order: the side follows from the measuring order, because the pose before has a smaller or a larger joint value. A joint that hardly
//! moved keeps its side. Each joint's backlash is one parameter, the coefficient of the joint's effect times ±½. It is fitted together with
//! the robot and its misfit. The largest gain must exceed what noise gives for any joint (Bonferroni), and the gain in random orders of the
//! configurations. Backlash is searched in one joint after another.
//!
//! By repeats: the pose before may not be in the file, e.g. if an arm goes to the same pose from above and from below through poses that
//! nobody measured. Visits of one pose then differ along the effect of that joint and not across it. F compares both scatters over all
//! poses that were visited several times. A drift moves all poses alike, but a joint moves each in its own direction. F must therefore
//! exceed the values that result if the joint's effects are exchanged between poses.

use crate::identification::screening::outliers::Linearised;
use crate::identification::screening::row_order::{
    OrderedPoints, by_configuration, holds_in_random_orders,
};
use crate::identification::screening::settling::REPEATABILITY_PER_REACH;
use crate::identification::screening::whitening::Whitened;
use crate::identification::statistics::distributions::{chi_square_quantile, f_tail};
use crate::solvers::products::side_by_side;
use nalgebra::{DMatrix, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Probability of reporting backlash if there is none.
const FALSE_ALARMS: f64 = 0.002;
/// Number of tests (by order and by repeats) that share this probability.
const N_TESTS: f64 = 2.0;
/// A joint that moves by less, rad (0.1°), keeps its side: joint readings have noise, and such a small move may not take up the backlash.
const MIN_MOVE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Minimum share of a joint's column that the fit leaves visible. If a joint always came from the same side, backlash only changes its
/// zero.
const MIN_VISIBLE_SHARE: f64 = 1e-3;
/// Minimum number of poses that were visited several times. Six poses can be exchanged in 720 ways.
const MIN_POSES: usize = 6;
/// Backlash that moves the points by less than this share of the noise of a coordinate (rms) is not reported, however significant it is.
const SMALLEST_EFFECT: f64 = 0.25;
/// Another joint explains the points as well if noise alone causes the difference in likelihood in more than this share of cases.
const AS_GOOD: f64 = 0.01;

/// How backlash shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShownBy {
    /// By the side from which the pose before in the measuring order comes.
    Order,
    /// By the scatter of visits of the same poses along the joint's effect.
    Repeats {
        /// Number of poses that were visited several times.
        n_poses: usize,
    },
}

/// Backlash of a joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Backlash {
    /// The joint, and others that explain the points as well; counted from 0.
    pub joints: Vec<usize>,
    /// Difference of the joint's position between both sides, rad. It is positive if the arm lags behind the joint value.
    pub backlash_rad: f64,
    /// Effect on a coordinate of a point (rms), mm.
    pub effect_mm: f64,
    /// How it shows.
    pub shown_by: ShownBy,
}

/// The result, and the columns that a fit needs to include the backlash.
pub struct Found {
    /// Backlash, one entry per joint.
    pub backlash: Vec<Backlash>,
    /// 3·N × k.
    pub columns: DMatrix<f64>,
}

/// A joint whose backlash was fitted.
struct Fitted {
    joint: usize,
    gain: f64,
    /// Coefficient of its column, rad.
    coefficient: f64,
    column: DMatrix<f64>,
}

/// Scatter of visits along the effect of a joint and across it.
struct Scatter {
    along: f64,
    across: f64,
    /// Σ (visits − 1) and Σ visits.
    freedom: f64,
    n_visits: f64,
    /// Mean square of the effect of one rad, mm².
    effect_mm2: f64,
}

impl Scatter {
    fn f(&self) -> f64 {
        self.along / (0.5 * self.across).max(f64::MIN_POSITIVE)
    }
}

impl OrderedPoints<'_> {
    /// The backlash of all joints.
    pub fn backlash(&self) -> Found {
        let n_rows = self.linear.residuals.len();
        let mut found = Found {
            backlash: vec![],
            columns: DMatrix::zeros(n_rows, 0),
        };
        let places: Vec<usize> = (0..self.q_rad.len()).collect();
        let mut linear = self.linear.clone();
        while found.backlash.len() < self.n_joints()
            && let Some((backlash, column)) = self.backlash_by_order(&linear, &places)
        {
            linear = linear.with(&column);
            found.columns = side_by_side(&[&found.columns, &column]);
            found.backlash.push(backlash);
        }
        if let Some((backlash, columns)) = self.backlash_by_repeats(&linear) {
            found.columns = side_by_side(&[&found.columns, &columns]);
            found.backlash.push(backlash);
        }
        found
    }

    fn n_joints(&self) -> usize {
        self.joints.first().map_or(0, |effects| effects.ncols())
    }

    /// Side from which a joint reached each point, for points measured in this order: 1 from below, −1 from above, 0 before its first move.
    fn sides(&self, places: &[usize], joint: usize) -> Vec<f64> {
        let mut sides = vec![0.0; places.len()];
        let mut side = 0.0;
        let mut before: Option<f64> = None;
        for place in places {
            let q = self.q_rad[*place][joint];
            let moved = before.map_or(0.0, |before| q - before);
            if moved.abs() > MIN_MOVE_RAD {
                side = moved.signum();
            }
            before = Some(q);
            sides[*place] = side;
        }
        sides
    }

    /// Effect of a joint on each point, times a factor; 3·N × 1.
    fn column(&self, joint: usize, factors: &[f64]) -> DMatrix<f64> {
        let mut column = DMatrix::zeros(3 * factors.len(), 1);
        for (place, factor) in factors.iter().enumerate() {
            let effect = self.joints[place].column(joint) * *factor;
            column.view_mut((3 * place, 0), (3, 1)).copy_from(&effect);
        }
        column
    }

    fn fitted_play(&self, problem: &Whitened, places: &[usize]) -> Vec<Fitted> {
        let fitted = |joint: usize| {
            let sides = self.sides(places, joint);
            // The arm lags behind the joint value.
            let factors: Vec<f64> = sides.iter().map(|side| -0.5 * side).collect();
            let column = self.column(joint, &factors);
            let gain = problem.fitted(&column)?;
            let visible = 1.0 / gain.inverse[(0, 0)];
            (visible >= MIN_VISIBLE_SHARE * column.norm_squared()).then_some(Fitted {
                joint,
                gain: gain.gain,
                coefficient: gain.coefficients[0],
                column,
            })
        };
        (0..self.n_joints()).filter_map(fitted).collect()
    }

    /// The backlash that explains most by the measuring order, and its column.
    fn backlash_by_order(
        &self,
        linear: &Linearised,
        places: &[usize],
    ) -> Option<(Backlash, DMatrix<f64>)> {
        self.watch.goes_on().then_some(())?;
        let problem = Whitened::new(linear, &self.features, self.watch);
        let left = problem.residuals.norm_squared();
        let rows = problem.residuals.len() as f64;
        let freedom = rows - problem.n_fitted as f64 - 1.0;
        if freedom < 3.0 || left <= rows * linear.rounding_mm * linear.rounding_mm {
            return None;
        }
        let tried = self.fitted_play(&problem, places);
        let design = problem.design_effect(self.clusters.iter().copied());
        let best = tried.iter().max_by(|a, b| a.gain.total_cmp(&b.gain))?;
        let variance = (left - best.gain).max(f64::MIN_POSITIVE) / freedom;
        let probability = f_tail(best.gain / variance / design, 1.0, freedom);
        let effect_mm = best.coefficient.abs() * best.column.norm() / rows.sqrt();
        if probability * tried.len() as f64 > FALSE_ALARMS / N_TESTS
            || effect_mm < SMALLEST_EFFECT * variance.sqrt()
            || !self.is_backlash_significant(&problem, best.gain)
        {
            return None;
        }
        let enough = best.gain - chi_square_quantile(AS_GOOD, 1.0) * variance * design;
        let others = tried
            .iter()
            .filter(|t| t.joint != best.joint && t.gain >= enough);
        let backlash = Backlash {
            joints: [best.joint]
                .into_iter()
                .chain(others.map(|t| t.joint))
                .collect(),
            backlash_rad: best.coefficient,
            effect_mm,
            shown_by: ShownBy::Order,
        };
        // Before a joint's first move, its side is unknown.
        let sides = self.sides(places, best.joint);
        let unknown: Vec<f64> = sides.iter().map(|side| 1.0 - side.abs()).collect();
        let column = side_by_side(&[&best.column, &self.column(best.joint, &unknown)]);
        Some((backlash, column))
    }

    /// True if no joint gains as much in random orders of the configurations.
    fn is_backlash_significant(&self, problem: &Whitened, gain: f64) -> bool {
        holds_in_random_orders(by_configuration(&self.clusters), self.watch, |places| {
            self.fitted_play(problem, places)
                .iter()
                .all(|other| other.gain <= gain)
        })
    }

    /// Groups of points of the same target in the same configuration; only groups of several.
    fn poses(&self) -> Vec<Vec<usize>> {
        let mut visits: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for (place, key) in self.clusters.iter().zip(&self.targets).enumerate() {
            visits.entry((*key.0, *key.1)).or_default().push(place);
        }
        visits
            .into_values()
            .filter(|visits| visits.len() > 1)
            .collect()
    }

    /// Scatter of the visits along the effect of a joint. Pose k is compared with the effect at pose `exchanged[k]`.
    fn scatter(
        &self,
        linear: &Linearised,
        poses: &[Vec<usize>],
        joint: usize,
        exchanged: &[usize],
    ) -> Scatter {
        let at = |i: usize| -> Vector3<f64> { linear.residuals.fixed_rows::<3>(3 * i).into() };
        let mut sum = Scatter {
            along: 0.0,
            across: 0.0,
            freedom: 0.0,
            n_visits: 0.0,
            effect_mm2: 0.0,
        };
        for (visits, other) in poses.iter().zip(exchanged) {
            let n = visits.len() as f64;
            let mean = visits.iter().map(|i| at(*i)).sum::<Vector3<f64>>() / n;
            let effect = self.joints[poses[*other][0]].column(joint);
            let along = effect.try_normalize(f64::MIN_POSITIVE).unwrap_or_default();
            for i in visits {
                let y = at(*i) - mean;
                let a = along.dot(&y);
                sum.along += a * a;
                sum.across += y.norm_squared() - a * a;
            }
            sum.freedom += n - 1.0;
            sum.n_visits += n;
            sum.effect_mm2 += n * effect.norm_squared();
        }
        sum.effect_mm2 /= sum.n_visits.max(1.0);
        sum
    }

    /// Side of each visit, from its position along the effect of a joint: ½ or −½; 0 for points that were visited once.
    fn halves(&self, linear: &Linearised, poses: &[Vec<usize>], joint: usize) -> Vec<f64> {
        let mut halves = vec![0.0; self.clusters.len()];
        for visits in poses {
            let along = |i: usize| {
                let y = linear.residuals.fixed_rows::<3>(3 * i);
                self.joints[i].column(joint).dot(&y)
            };
            let mean = visits.iter().map(|i| along(*i)).sum::<f64>() / visits.len() as f64;
            for i in visits {
                halves[*i] = 0.5 * (along(*i) - mean).signum();
            }
        }
        halves
    }

    /// Backlash from the visits of the same poses, whatever side they came from, and the column that a fit needs to include it.
    fn backlash_by_repeats(&self, linear: &Linearised) -> Option<(Backlash, DMatrix<f64>)> {
        let poses = self.poses();
        if poses.len() < MIN_POSES || !self.watch.goes_on() {
            return None;
        }
        let n_joints = self.n_joints();
        let own: Vec<usize> = (0..poses.len()).collect();
        let of_joint = |joint: usize| (joint, self.scatter(linear, &poses, joint, &own));
        let tried: Vec<(usize, Scatter)> = (0..n_joints).map(of_joint).collect();
        let best = tried.iter().max_by(|a, b| a.1.f().total_cmp(&b.1.f()))?;
        let (joint, scatter) = (best.0, &best.1);
        let freedom = scatter.freedom;
        let rounding = linear.rounding_mm * linear.rounding_mm;
        let noise = (scatter.across / (2.0 * freedom)).max(rounding);
        let of_play = scatter.along / freedom - noise;
        // If the sides alternate, each visit deviates from the middle by half the backlash.
        let square = of_play.max(0.0) * freedom / scatter.n_visits;
        let effect_mm = (square / 3.0).sqrt();
        // The targets of a visit share its error, so together they count once.
        let configurations: BTreeSet<usize> = poses.iter().map(|p| self.clusters[p[0]]).collect();
        let independent = freedom * configurations.len() as f64 / poses.len() as f64;
        let ratio = scatter.along / freedom / noise;
        let probability = f_tail(ratio, independent, 2.0 * independent);
        if probability * n_joints as f64 > FALSE_ALARMS / N_TESTS
            || of_play < SMALLEST_EFFECT * SMALLEST_EFFECT * noise
            || effect_mm < REPEATABILITY_PER_REACH * self.reach_mm
        {
            return None;
        }
        let largest = scatter.f();
        let blocks = own.iter().map(|pose| vec![*pose]).collect();
        let stands_out = holds_in_random_orders(blocks, self.watch, |exchanged| {
            (0..n_joints).all(|joint| self.scatter(linear, &poses, joint, exchanged).f() <= largest)
        });
        if !stands_out {
            return None;
        }
        // Another joint explains the points as well if its scatter differs from that of the best one only by chance.
        let log = |s: &Scatter| independent * (libm::log(s.along) + 2.0 * libm::log(s.across));
        let enough = chi_square_quantile(AS_GOOD, 1.0);
        let others = tried.iter().filter(|t| {
            let worse = -log(scatter) + log(&t.1);
            t.0 != joint && t.1.along > t.1.across / 2.0 && worse <= enough
        });
        let joints = [joint].into_iter().chain(others.map(|t| t.0)).collect();
        let column = self.column(joint, &self.halves(linear, &poses, joint));
        let backlash = Backlash {
            joints,
            backlash_rad: 2.0 * (square / scatter.effect_mm2).sqrt(),
            effect_mm,
            shown_by: ShownBy::Repeats {
                n_poses: poses.len(),
            },
        };
        Some((backlash, column))
    }
}
