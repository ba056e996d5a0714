//! Outlier detection from the linear problem at a fit, with an unknown number of outliers.
//!
//! Least squares spreads an outlier's error over its neighbours, so the outlier's own residual does not show it. Two starts avoid this: the
//! fit of least absolute lengths, and the deletion of points one after another by their predicted residuals. The predicted residual of a
//! point is the one that it would have if it were not fitted. Each start is continued by Tukey's biweight at the scale found there (an
//! MM-estimate [Yohai 1987]). The result whose best nine tenths have the smallest scatter is kept (least trimmed squares [Rousseeuw 1984]).
//! Points are then included and excluded until nothing changes. The criterion is a point's predicted residual over its standard deviation.

use crate::identification::statistics::distributions::f_tail;
use crate::solvers::loss::{Loss, TUKEY_C_95};
use crate::solvers::orthonormal::orthonormal;
use crate::solvers::products::{add_weighted_square, side_by_side};
use crate::solvers::watch::Watch;
use nalgebra::{Cholesky, DMatrix, DMatrixView, DVector, Dyn, Matrix3, Vector3};
use std::borrow::Cow;
use std::cmp::Ordering;

/// Minimum predicted residual of an outlier, in standard deviations: exceeded by one in 10⁷ normal points.
const OUTLIER_SIGMAS: f64 = 6.0;
/// Significance level of an outlier: in at most one of a thousand sets of this size, noise causes such a residual.
const FALSE_ALARMS: f64 = 1e-3;
/// Number of iterations of each start and of the biweight; the weights converge in about ten.
const REWEIGHTINGS: usize = 30;
/// Maximum number of rounds in which points are included and excluded.
const EXCHANGES: usize = 20;
/// Limit of points times rounds of deletions, and minimum number of rounds. With up to a thousand points, one point is deleted at a time.
/// With a hundred thousand points, a tenth of the possible outliers is deleted at a time.
const DELETION_WORK: usize = 100_000;
const MIN_DELETIONS: usize = 10;
/// Maximum share of the points that the search treats as outliers.
const MAX_OUTLIERS: f64 = 0.1;
/// Ridge on every coefficient of the basis, as a share of what all points show of it. Without it, rounding would decide on coefficients that no
/// kept point determines, for example the placement of a segment all of whose points are left out.
const RIDGE: f64 = 1e-12;
/// Number of points between two checks whether to stop.
const POINTS_AT_ONCE: usize = 5_000;
/// Median of the length of three standard normal numbers.
const MEDIAN_LENGTH: f64 = 1.538_17;
/// Residuals below this share of the reach carry no information: a nanometre on an arm of 1.7 m, the rounding of files and iterations.
pub const ROUNDING_PER_REACH: f64 = 1e-6 / 1700.0;

/// The linear problem at a fit: residuals, and an orthonormal basis of the changes that parameters can make. Three rows per point, weighted.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// 3·N, mm.
    pub residuals: DVector<f64>,
    /// 3·N × r, orthonormal columns.
    pub basis: DMatrix<f64>,
    /// Residuals below this carry no information, mm.
    pub rounding_mm: f64,
}

/// The detected outliers.
#[derive(Clone, Debug, PartialEq)]
pub struct Outliers {
    /// Indices of the points, ascending.
    pub points: Vec<usize>,
    /// Residual of each outlier if it is not fitted, mm (times the root of its weight).
    pub sizes_mm: Vec<f64>,
    /// Standard deviation of one coordinate of the other points, mm.
    pub scale_mm: f64,
}

/// Expected errors along some directions, in addition to the noise.
pub struct ExpectedErrors<'a> {
    /// 3·N × k, orthonormal columns.
    pub directions: &'a DMatrix<f64>,
    /// Variance along each direction, relative to that of the noise; k.
    pub variances: &'a [f64],
}

/// A problem with the data that every weighted fit needs for each point, computed once.
struct Blocks<'a> {
    of: &'a Linearised,
    /// Q, and the directions of expected errors; 3·N × r.
    basis: Cow<'a, DMatrix<f64>>,
    /// Noise variance over the prior variance of each coefficient, r.
    ridge: Vec<f64>,
    /// Qᵀ, r × 3·N: the entries of a point are contiguous.
    transposed: DMatrix<f64>,
    watch: &'a Watch<'a>,
}

/// A weighted fit.
struct Solved {
    /// Residuals of every point.
    residuals: Vec<Vector3<f64>>,
    /// Factor of the normal matrix.
    factor: Cholesky<f64, Dyn>,
    /// Σ ridge·coefficient², mm².
    prior_cost: f64,
}

/// A fit of the linear problem to the kept points.
struct Kept {
    /// Residuals of all points.
    residuals: Vec<Vector3<f64>>,
    /// Leverages Q_i·(Q_Kᵀ·Q_K)⁻¹·Q_iᵀ of all points.
    leverages: Vec<Matrix3<f64>>,
    /// σ², mm².
    variance: f64,
    freedom: f64,
}

impl Linearised {
    /// From weighted residuals and the weighted derivatives along the observable combinations.
    pub fn new(residuals: &DVector<f64>, derivatives: DMatrix<f64>, rounding_mm: f64) -> Self {
        let basis = orthonormal(derivatives);
        Self {
            residuals: residuals - &basis * basis.tr_mul(residuals),
            basis,
            rounding_mm,
        }
    }

    /// The problem with further columns that are fitted.
    pub fn with(&self, columns: &DMatrix<f64>) -> Self {
        let all = side_by_side(&[&self.basis, columns]);
        Self::new(&self.residuals, all, self.rounding_mm)
    }

    /// The problem of some of the points, in the given order.
    pub fn of(&self, points: &[usize]) -> Self {
        let row = |row: usize| 3 * points[row / 3] + row % 3;
        let basis = DMatrix::from_fn(3 * points.len(), self.basis.ncols(), |r, c| {
            self.basis[(row(r), c)]
        });
        Self::new(
            &DVector::from_fn(3 * points.len(), |r, _| self.residuals[row(r)]),
            basis,
            self.rounding_mm,
        )
    }

    /// Number of points.
    pub fn n_points(&self) -> usize {
        self.residuals.len() / 3
    }

    /// True if there are enough residuals to find outliers: more than 1.5 times the number of combinations, plus 6.
    fn is_overdetermined(&self) -> bool {
        3 * self.n_points() > self.basis.ncols() + self.basis.ncols() / 2 + 6
    }

    /// σ of one coordinate from the median length. As many points as the fit can pass through exactly are left out.
    fn median_scale(&self, residuals: &[Vector3<f64>]) -> f64 {
        let mut lengths: Vec<f64> = residuals.iter().map(Vector3::norm).collect();
        lengths.sort_by(f64::total_cmp);
        let through = (self.basis.ncols() / 3).min(lengths.len().saturating_sub(1));
        let rest = &lengths[through..];
        (rest[rest.len() / 2] / MEDIAN_LENGTH).max(self.rounding_mm)
    }

    /// The outliers; `None` if there are too few points to find any. The standard deviation of a coordinate is at least `least_scale_mm`.
    pub fn outliers(&self, least_scale_mm: f64, watch: &Watch<'_>) -> Option<Outliers> {
        let least_scale_mm = least_scale_mm.max(self.rounding_mm);
        self.is_overdetermined()
            .then(|| Blocks::new(self, watch).outliers(least_scale_mm))?
    }

    /// The outliers if errors are expected in addition to the noise. `found` are the outliers without these expected errors. `None` when
    /// the watch stops.
    pub fn outliers_beside(
        &self,
        found: &Outliers,
        expected: &ExpectedErrors<'_>,
        least_scale_mm: f64,
        watch: &Watch<'_>,
    ) -> Option<Outliers> {
        let least_scale_mm = least_scale_mm.max(self.rounding_mm);
        let mut kept = vec![true; self.n_points()];
        found.points.iter().for_each(|i| kept[*i] = false);
        Blocks::beside(self, expected, watch).outliers_from(kept, least_scale_mm)
    }
}

impl<'a> Blocks<'a> {
    fn new(of: &'a Linearised, watch: &'a Watch<'a>) -> Self {
        Self {
            of,
            basis: Cow::Borrowed(&of.basis),
            ridge: vec![RIDGE; of.basis.ncols()],
            transposed: of.basis.transpose(),
            watch,
        }
    }

    fn beside(of: &'a Linearised, expected: &ExpectedErrors<'_>, watch: &'a Watch<'a>) -> Self {
        let basis = side_by_side(&[&of.basis, expected.directions]);
        let mut ridge = vec![RIDGE; of.basis.ncols()];
        ridge.extend(expected.variances.iter().map(|variance| 1.0 / variance));
        Self {
            of,
            transposed: basis.transpose(),
            basis: Cow::Owned(basis),
            ridge,
            watch,
        }
    }

    /// A fit with these weights. `None` if the normal matrix is singular, or when the watch stops.
    fn solve(&self, weights: &[f64]) -> Option<Solved> {
        let r = self.basis.ncols();
        let (mut square, mut weighted) = (vec![0.0; r * r], self.of.residuals.clone());
        let points = weights
            .iter()
            .zip(self.transposed.as_slice().chunks((3 * r).max(1)));
        for (i, (weight, rows)) in points.enumerate() {
            if i % POINTS_AT_ONCE == 0 && !self.watch.goes_on() {
                return None;
            }
            weighted.fixed_rows_mut::<3>(3 * i).scale_mut(*weight);
            if *weight != 0.0 {
                add_weighted_square(*weight, rows, r, &mut square);
            }
        }
        let side = &self.transposed * weighted;
        let normal = DMatrix::from_fn(r, r, |row, column| match column.cmp(&row) {
            Ordering::Less => square[r * row + column],
            Ordering::Equal => square[r * row + column] + self.ridge[row],
            Ordering::Greater => 0.0,
        });
        // uses only the lower triangle
        let factor = Cholesky::new(normal)?;
        let u = factor.solve(&side);
        let left = &self.of.residuals - &*self.basis * &u;
        Some(Solved {
            residuals: (0..self.of.n_points())
                .map(|i| left.fixed_rows::<3>(3 * i).into())
                .collect(),
            factor,
            prior_cost: u
                .iter()
                .zip(&self.ridge)
                .map(|(u, ridge)| ridge * u * u)
                .sum(),
        })
    }

    /// Q_iᵀ of `n_points` points at a time.
    fn blocks_of(&self, n_points: usize) -> impl Iterator<Item = DMatrixView<'_, f64>> {
        let n = self.of.n_points();
        let first = (0..n).step_by(n_points);
        first.map(move |i| self.transposed.columns(3 * i, 3 * n_points.min(n - i)))
    }

    fn keep(&self, kept: &[bool]) -> Option<Kept> {
        let weights: Vec<f64> = kept.iter().map(|k| f64::from(u8::from(*k))).collect();
        let Solved {
            residuals,
            factor,
            prior_cost,
        } = self.solve(&weights)?;
        let freedom = 3.0 * weights.iter().sum::<f64>() - self.of.basis.ncols() as f64;
        let sum: f64 = residuals
            .iter()
            .zip(&weights)
            .map(|(r, w)| w * r.norm_squared())
            .sum();
        if freedom < 3.0 {
            return None;
        }
        let mut leverages = Vec::with_capacity(self.of.n_points());
        for columns in self.blocks_of(POINTS_AT_ONCE) {
            if !self.watch.goes_on() {
                return None;
            }
            let halves = factor.l_dirty().solve_lower_triangular(&columns)?;
            leverages.extend((0..halves.ncols() / 3).map(|i| {
                let half = halves.fixed_columns::<3>(3 * i);
                Matrix3::from_fn(|row, column| half.column(row).dot(&half.column(column)))
            }));
        }
        Some(Kept {
            residuals,
            leverages,
            variance: (sum + prior_cost) / freedom,
            freedom,
        })
    }

    /// The fit of least absolute lengths.
    fn least_lengths(&self) -> Option<Vec<Vector3<f64>>> {
        let mut weights = vec![1.0; self.of.n_points()];
        let mut residuals = self.solve(&weights)?.residuals;
        for _ in 0..REWEIGHTINGS {
            let smallest = 1e-3 * self.of.median_scale(&residuals);
            weights
                .iter_mut()
                .zip(&residuals)
                .for_each(|(w, r)| *w = smallest / r.norm().max(smallest));
            residuals = self.solve(&weights)?.residuals;
        }
        Some(residuals)
    }

    /// Deletes points, those with the largest predicted residual first; several at a time if there are many points.
    fn deletions(&self) -> Option<Vec<Vector3<f64>>> {
        let n = self.of.n_points();
        let n_rounds = (DELETION_WORK / n).max(MIN_DELETIONS);
        let at_once = most_outliers(n).div_ceil(n_rounds);
        let mut kept = vec![true; n];
        let mut fit = self.keep(&kept)?;
        for _ in 0..most_outliers(n).div_ceil(at_once) {
            let mut deleted_residuals_squared: Vec<(usize, f64)> = (0..n)
                .filter(|i| kept[*i])
                .map(|i| (i, fit.deleted_residual_squared(i, true)))
                .collect();
            // Of equal ones, the last comes first.
            deleted_residuals_squared.sort_by(|a, b| b.1.total_cmp(&a.1).then(b.0.cmp(&a.0)));
            deleted_residuals_squared
                .iter()
                .take(at_once)
                .for_each(|(worst, _)| kept[*worst] = false);
            match self.keep(&kept) {
                Some(next) => fit = next,
                None => break,
            }
        }
        Some(fit.residuals)
    }

    /// Tukey's biweight from a start, at the start's scale.
    fn biweight(&self, mut residuals: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
        let scale = self.of.median_scale(&residuals);
        let loss = Loss::Tukey { c: TUKEY_C_95 };
        for _ in 0..REWEIGHTINGS {
            let weights: Vec<f64> = residuals
                .iter()
                .map(|r| loss.weight(r.norm() / scale))
                .collect();
            match self.solve(&weights) {
                Some(next) => residuals = next.residuals,
                None => break,
            }
        }
        residuals
    }

    fn robust(&self) -> Option<(Vec<Vector3<f64>>, f64)> {
        let starts = [self.least_lengths(), self.deletions()]
            .into_iter()
            .flatten();
        let ends = starts.map(|start| self.biweight(start));
        let best = ends.min_by(|a, b| trimmed(a).total_cmp(&trimmed(b)))?;
        let scale = self.of.median_scale(&best);
        Some((best, scale))
    }

    fn outliers(&self, least_scale_mm: f64) -> Option<Outliers> {
        let (residuals, scale) = self.robust()?;
        let kept = residuals
            .iter()
            .map(|r| r.norm() <= OUTLIER_SIGMAS * scale.max(least_scale_mm))
            .collect();
        self.exchanged(kept, least_scale_mm)
    }

    /// The outliers, from a first guess of the good points. If the guess contains several outliers, they hide each other in least squares,
    /// but not in the biweight.
    fn outliers_from(&self, guess: Vec<bool>, least_scale_mm: f64) -> Option<Outliers> {
        let residuals = self.biweight(self.keep(&guess)?.residuals);
        let least_mm = OUTLIER_SIGMAS * self.of.median_scale(&residuals).max(least_scale_mm);
        let kept: Vec<bool> = residuals.iter().map(|r| r.norm() <= least_mm).collect();
        let n_out = kept.iter().filter(|is_kept| !**is_kept).count();
        match n_out <= most_outliers(kept.len()) {
            true => self.exchanged(kept, least_scale_mm),
            false => self.exchanged(guess, least_scale_mm),
        }
    }

    /// Includes and excludes points until nothing changes. `kept` are the initially kept points.
    fn exchanged(&self, mut kept: Vec<bool>, least_scale_mm: f64) -> Option<Outliers> {
        let n = self.of.n_points();
        let mut fit = self.keep(&kept).or_else(|| {
            kept = vec![true; n];
            self.keep(&kept)
        })?;
        for _ in 0..EXCHANGES {
            let next: Vec<bool> = (0..n)
                .map(|i| {
                    !is_outlier(
                        fit.deleted_residual_squared(i, kept[i]),
                        &fit,
                        least_scale_mm,
                        n,
                    )
                })
                .collect();
            if next == kept {
                break;
            }
            let Some(refit) = self.keep(&next) else { break };
            (kept, fit) = (next, refit);
        }
        let points: Vec<usize> = (0..n).filter(|i| !kept[*i]).collect();
        Some(Outliers {
            sizes_mm: points.iter().map(|i| fit.residuals[*i].norm()).collect(),
            points,
            scale_mm: fit.variance.sqrt().max(least_scale_mm),
        })
    }
}

impl Kept {
    /// Squared length of the residual that point i would have if it were not fitted, weighted by its covariance for σ = 1, mm².
    fn deleted_residual_squared(&self, i: usize, is_kept: bool) -> f64 {
        let leverage = self.leverages[i];
        let covariance = if is_kept {
            Matrix3::identity() - leverage
        } else {
            Matrix3::identity() + leverage
        };
        let solved = covariance.cholesky().map(|c| c.solve(&self.residuals[i]));
        solved.map_or(0.0, |x| x.dot(&self.residuals[i]))
    }
}

fn is_outlier(
    deleted_residual_squared: f64,
    fit: &Kept,
    least_scale_mm: f64,
    n_points: usize,
) -> bool {
    let square = deleted_residual_squared / fit.variance.max(least_scale_mm * least_scale_mm);
    square > OUTLIER_SIGMAS * OUTLIER_SIGMAS
        && f_tail(square / 3.0, 3.0, fit.freedom) * (n_points as f64) < FALSE_ALARMS
}

fn most_outliers(n_points: usize) -> usize {
    (MAX_OUTLIERS * n_points as f64).ceil() as usize
}

/// Sum of the smallest squares, without the share of points that may be outliers.
fn trimmed(residuals: &[Vector3<f64>]) -> f64 {
    let mut squares: Vec<f64> = residuals.iter().map(Vector3::norm_squared).collect();
    squares.sort_by(f64::total_cmp);
    squares.truncate(squares.len() - most_outliers(squares.len()).min(squares.len()));
    squares.iter().sum()
}
