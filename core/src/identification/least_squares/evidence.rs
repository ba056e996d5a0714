//! Estimates the noise and the widths of the priors from the linear problem at a fit.
//!
//! If the rows are linear in the coordinates, the most probable noise σ and the most probable widths are a fixed point [MacKay 1992]:
//!
//! - σ² is the sum of squares of the residuals, divided by the number of rows minus the number of coordinates that the rows determine;
//! - g² is the factor by which the prior variances of a kind have grown from their start values. It is the sum of squares of the kind's
//!   coordinates, divided by the number of those that the rows determine. It is at least 1 for links, and may be nearly 0 for corrections.
//!
//! Errors of links have heavy tails: most are small, but that of a joint that was never mastered is a hundred times larger. Each variable
//! of a kind therefore has Student's t distribution, written as a normal distribution with its own unknown variance: width² = g²·(ν +
//! x²/g²)/(ν + 1), with x² the expected square of the coordinate [Liu & Rubin 1995].
//!
//! σ starts far below the noise, so that at first the priors determine only what the rows do not.

use crate::identification::least_squares::problem::{KINDS, Prior, Problem};
use crate::identification::statistics::distributions::f_tail;
use crate::identification::statistics::variance::{Spectrum, probable_variance_over_usual};
use crate::solvers::qr::triangularise;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// ν of Student's t distribution. With 1 to 3, links of measured arms are predicted about equally well; with normal priors 3 % worse.
const TAILS: f64 = 2.0;
/// Maximum number of updates.
const UPDATES: usize = 100;
/// The updates end when noise and widths change by less than this share.
const CONVERGED: f64 = 1e-4;
/// Minimum number of determined coordinates for estimating the width of a kind.
const MIN_DETERMINED: f64 = 0.5;

/// See [`Noise::is_more_than`].
const SIGNIFICANCE_LEVEL: f64 = 1e-3;

/// Noise and widths.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// σ, standard deviation of a row of weight 1, mm.
    pub sigma_mm: f64,
    /// g, the factor by which the priors of each kind are wider than at the start; at least [`Kind::min_growth`]. In the order of [`KINDS`].
    pub prior_growth: [f64; KINDS.len()],
    /// Prior standard deviation of each coordinate.
    pub widths: Vec<f64>,
}

/// Noise about a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of a coordinate of a point of weight 1, mm. The degrees of freedom of the fit are taken into account.
    pub std_mm: f64,
    /// Number of rows minus the number of coordinates that they determine.
    pub freedom: f64,
}

impl Noise {
    /// The noise of a fit with this posterior.
    pub fn of(problem: &Problem<'_>, evidence: &Evidence, posterior: &Posterior) -> Self {
        Self {
            std_mm: evidence.sigma_mm,
            freedom: (problem.n_rows() as f64 - posterior.n_determined).max(1.0),
        }
    }

    /// True if the larger noise is significant: samples of the same noise differ as much in fewer than one of a thousand cases.
    pub fn is_more_than(&self, other: &Self) -> bool {
        let ratio = self.std_mm / other.std_mm;
        f_tail(ratio * ratio, self.freedom, other.freedom) < SIGNIFICANCE_LEVEL
    }
}

/// The rows of a problem at a fit, reduced to a triangle: |residuals + J·step|² = |right + R·step|² + rest.
#[derive(Clone, Debug)]
pub struct Triangle {
    /// R, p × p, upper triangle.
    r: DMatrix<f64>,
    /// Right side, p.
    right: Vec<f64>,
    /// Expected values of the coordinates, p, and which of them have a flat prior.
    expected: Vec<f64>,
    is_flat: Vec<bool>,
    rest: f64,
    n_rows: usize,
}

/// See [`Triangle::remaining_rows`].
pub struct RemainingRows {
    /// Derivatives by the last coordinates, upper triangle.
    pub columns: DMatrix<f64>,
    /// Residuals of the same rows.
    pub residuals: DVector<f64>,
    /// Sum of squares of all rows that do not depend on the last coordinates, mm².
    pub rest: f64,
    /// Degrees of freedom.
    pub n_free: f64,
}

impl RemainingRows {
    /// Spectrum for estimating the variance of the last coordinates.
    pub fn spectrum(&self) -> Option<Spectrum> {
        Spectrum::new(&self.residuals, &self.columns, self.rest, self.n_free)
    }

    /// The coordinate that explains most by itself. It must explain more than it leaves, and the probability that chance explains as much
    /// must be below `chance`.
    pub fn dominant(&self, chance: f64) -> Option<usize> {
        let along = |j: &usize| {
            let column = self.columns.column(*j);
            let along = column.dot(&self.residuals) / column.norm().max(f64::MIN_POSITIVE);
            along * along
        };
        let best = (0..self.columns.ncols()).max_by(|i, j| along(i).total_cmp(&along(j)))?;
        let left = self.residuals.norm_squared() + self.rest - along(&best);
        let n_free = self.n_free - 1.0;
        let is_significant =
            n_free >= 1.0 && f_tail(along(&best) / (left / n_free), 1.0, n_free) < chance;
        (is_significant && along(&best) > left).then_some(best)
    }
}

/// Solution of the linear problem for given noise and widths.
#[derive(Clone, Debug, PartialEq)]
pub struct Posterior {
    /// Step from the fit to the solution, in coordinates.
    pub step: Vec<f64>,
    /// Root of the covariance of the coordinates, p × p: covariance = root · rootᵀ.
    pub root: DMatrix<f64>,
    /// Share of each coordinate that the rows determine: 1 − posterior variance / prior variance. For a flat prior, the variable's width is
    /// used instead of the prior's: a coordinate whose uncertainty exceeds the reach is not determined.
    pub data_share: Vec<f64>,
    /// Number of coordinates that the rows determine.
    pub n_determined: f64,
}

impl Evidence {
    /// Width of a flat prior, in units of the variable's width. It is so large that base and targets may be anywhere. If no row determines
    /// a part of their position, e.g. a common shift along a single axis, this part keeps its initial value.
    pub const FLAT: f64 = 1e3;

    /// Noise and widths before any row is used.
    pub fn first(problem: &Problem<'_>, sigma_mm: f64) -> Self {
        let width = |prior: Prior| match prior {
            Prior::OfKind(_) => 1.0,
            Prior::Stated { std, .. } => std,
            Prior::Flat => Self::FLAT,
        };
        Self {
            sigma_mm,
            prior_growth: [1.0; KINDS.len()],
            widths: problem.variables.iter().map(|v| width(v.prior)).collect(),
        }
    }

    /// True if noise and widths equal those of `other` to within a relative difference.
    pub fn is_near(&self, other: &Self, difference: f64) -> bool {
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= difference * b;
        near((&self.sigma_mm, &other.sigma_mm)) && self.widths.iter().zip(&other.widths).all(near)
    }

    /// The next iterate of the fixed point. The noise is at least `least_sigma_mm`.
    fn updated(
        &self,
        at: &Triangle,
        problem: &Problem<'_>,
        x: &[f64],
        least_sigma_mm: f64,
    ) -> Self {
        let posterior = at.solve(x, self);
        let mut next = Self {
            sigma_mm: at.noise_mm(problem, &posterior).max(least_sigma_mm),
            ..self.clone()
        };
        for (k, kind) in KINDS.into_iter().enumerate() {
            let of_kind = |j: &usize| problem.variables[*j].prior == Prior::OfKind(kind);
            let (mut squares, mut determined) = (0.0, 0.0);
            for j in (0..x.len()).filter(of_kind) {
                let coordinate = x[j] + posterior.step[j];
                let tail = self.widths[j] / self.prior_growth[k];
                squares += coordinate * coordinate / (tail * tail);
                determined += posterior.data_share[j];
            }
            if determined > MIN_DETERMINED {
                next.prior_growth[k] = (squares / determined).sqrt().max(kind.min_growth());
            }
            let g2 = next.prior_growth[k] * next.prior_growth[k];
            for j in (0..x.len()).filter(of_kind) {
                let coordinate = x[j] + posterior.step[j];
                let expected = coordinate * coordinate + posterior.root.row(j).norm_squared();
                next.widths[j] = ((TAILS * g2 + expected) / (TAILS + 1.0)).sqrt();
            }
        }
        next
    }
}

impl Posterior {
    /// Distance of the fit from the solution, in standard deviations: root mean square over the coordinates that the rows determine.
    pub fn stds_from_fit(&self) -> f64 {
        let step = DVector::from_column_slice(&self.step);
        let whitened = self.root.solve_upper_triangular(&step);
        whitened.map_or(f64::INFINITY, |stds| {
            stds.norm() / self.n_determined.max(1.0).sqrt()
        })
    }
}

impl Triangle {
    /// A triangle without rows, for `p` coordinates, all with flat priors.
    pub fn empty(p: usize) -> Self {
        Self {
            r: DMatrix::zeros(p, p),
            right: vec![0.0; p],
            expected: vec![0.0; p],
            is_flat: vec![true; p],
            rest: 0.0,
            n_rows: 0,
        }
    }

    /// The triangle of the rows of several triangles of one problem.
    pub fn of_all<'t>(triangles: impl Iterator<Item = &'t Self>) -> Self {
        let mut all: Option<Self> = None;
        for triangle in triangles {
            match &mut all {
                None => all = Some(triangle.clone()),
                Some(all) => {
                    all.append(&[(triangle.r.clone(), triangle.right.clone())]);
                    all.rest += triangle.rest;
                    all.n_rows = all.n_rows + triangle.n_rows - triangle.right.len();
                }
            }
        }
        all.unwrap_or_else(|| Self::empty(0))
    }

    /// Appends rows. Each block has derivatives and residuals.
    pub fn append(&mut self, blocks: &[(DMatrix<f64>, Vec<f64>)]) {
        let p = self.right.len();
        let more: usize = blocks.iter().map(|(_, residuals)| residuals.len()).sum();
        let mut stacked = DMatrix::zeros(p + more, p);
        stacked.rows_mut(0, p).copy_from(&self.r);
        let mut right = self.right.clone();
        for (matrix, residuals) in blocks {
            stacked
                .rows_mut(right.len(), residuals.len())
                .copy_from(matrix);
            right.extend(residuals);
        }
        triangularise(stacked.as_mut_slice(), p + more, &mut right);
        self.r = stacked.rows(0, p).upper_triangle();
        self.rest += right[p..].iter().map(|v| v * v).sum::<f64>();
        right.truncate(p);
        self.right = right;
        self.n_rows += more;
    }

    /// States that some coordinates have a prior about 0.
    pub fn expect_zero(&mut self, coordinates: Range<usize>) {
        self.is_flat[coordinates].fill(false);
    }

    /// Sets the expected values of the first `n` coordinates from a problem. All others have a flat prior.
    pub fn expect(&mut self, problem: &Problem<'_>, n: usize) {
        for (j, variable) in problem.variables.iter().take(n).enumerate() {
            self.expected[j] = problem.expected(j);
            self.is_flat[j] = variable.prior == Prior::Flat;
        }
    }

    /// The same rows. Coordinates with a flat prior stay at `x` if no row determines them.
    pub fn with_flat_at(mut self, x: &[f64]) -> Self {
        for (j, is_flat) in self.is_flat.iter().enumerate() {
            if *is_flat {
                self.expected[j] = x[j];
            }
        }
        self
    }

    /// The rows at a step from the fit.
    pub fn moved(mut self, step: &[f64]) -> Self {
        let by_step = &self.r * DVector::from_column_slice(step);
        for (right, by_step) in self.right.iter_mut().zip(&by_step) {
            *right += by_step;
        }
        self
    }

    /// The coordinates with a flat prior that the rows do not determine: stations and targets without points.
    pub fn undetermined(&self, posterior: &Posterior) -> Vec<usize> {
        let is_undetermined = |j: &usize| self.is_flat[*j] && posterior.data_share[*j] < 0.5;
        (0..self.right.len()).filter(is_undetermined).collect()
    }

    /// Number of coordinates.
    pub fn n_coordinates(&self) -> usize {
        self.right.len()
    }

    /// Effect of noise of standard deviation σ on a solution: C·Rᵀ/σ, p × p.
    pub fn by_noise(&self, posterior: &Posterior, sigma_mm: f64) -> DMatrix<f64> {
        &posterior.root * (posterior.root.transpose() * self.r.transpose()) / sigma_mm
    }

    /// The triangle of some coordinates, in the given order; the others stay at the fit.
    pub fn of_columns(&self, columns: &[usize]) -> Self {
        let (n, p) = (columns.len(), self.right.len());
        let mut stacked = self.r.select_columns(columns);
        let mut right = self.right.clone();
        triangularise(stacked.as_mut_slice(), p, &mut right);
        Self {
            r: stacked.rows(0, n).upper_triangle(),
            expected: columns.iter().map(|j| self.expected[*j]).collect(),
            is_flat: columns.iter().map(|j| self.is_flat[*j]).collect(),
            rest: self.rest + right[n..].iter().map(|v| v * v).sum::<f64>(),
            right: right[..n].to_vec(),
            n_rows: self.n_rows,
        }
    }

    /// Rows for the last coordinates, from `first` on: the information about them that is left after all other coordinates have been fitted
    /// with their priors.
    pub fn remaining_rows(&self, x: &[f64], evidence: &Evidence, first: usize) -> RemainingRows {
        let p = self.right.len();
        let n = p + first;
        let (mut stacked, mut right) = (DMatrix::zeros(n, p), vec![0.0; n]);
        stacked.rows_mut(0, p).copy_from(&self.r);
        right[..p].copy_from_slice(&self.right);
        for (j, width) in evidence.widths[..first].iter().enumerate() {
            stacked[(p + j, j)] = evidence.sigma_mm / width;
            right[p + j] = evidence.sigma_mm * (x[j] - self.expected[j]) / width;
        }
        triangularise(stacked.as_mut_slice(), n, &mut right);
        let columns = stacked.view((first, first), (p - first, p - first));
        // Rows of priors count as data, except those of flat priors.
        let n_flat = self.is_flat[..first].iter().filter(|flat| **flat).count();
        RemainingRows {
            columns: columns.upper_triangle(),
            residuals: DVector::from_column_slice(&right[first..p]),
            rest: self.rest + right[p..].iter().map(|v| v * v).sum::<f64>(),
            n_free: self.n_rows as f64 - n_flat as f64,
        }
    }

    /// R, right side, and sum of squares of the rest.
    pub fn reduced(&self) -> (&DMatrix<f64>, &[f64], f64) {
        (&self.r, &self.right, self.rest)
    }

    /// Reduces the rows at a fit to a triangle.
    pub fn at(problem: &Problem<'_>, x: &[f64]) -> Self {
        let (n_rows, p) = (problem.n_rows(), x.len());
        // With fewer rows than coordinates, rows of zeros are added.
        let n = n_rows.max(p);
        let (mut residuals, mut jacobian) = (vec![0.0; n], DMatrix::zeros(n, p));
        problem.evaluate(x, &mut residuals, Some(&mut jacobian));
        if p > 0 {
            triangularise(jacobian.as_mut_slice(), n, &mut residuals);
        }
        Self {
            r: jacobian.rows(0, p).upper_triangle(),
            rest: residuals[p..].iter().map(|v| v * v).sum(),
            right: residuals[..p].to_vec(),
            expected: (0..p).map(|j| problem.expected(j)).collect(),
            is_flat: problem
                .variables
                .iter()
                .map(|v| v.prior == Prior::Flat)
                .collect(),
            n_rows,
        }
    }

    /// Solves the linear problem: least squares of the rows divided by σ, and of the coordinates divided by the widths of their priors. `x` is the
    /// fit.
    pub fn solve(&self, x: &[f64], evidence: &Evidence) -> Posterior {
        let p = x.len();
        let (mut stacked, mut right) = (DMatrix::zeros(2 * p, p), vec![0.0; 2 * p]);
        stacked
            .rows_mut(0, p)
            .copy_from(&(&self.r / evidence.sigma_mm));
        for (j, width) in evidence.widths.iter().enumerate() {
            stacked[(p + j, j)] = 1.0 / width;
            right[j] = self.right[j] / evidence.sigma_mm;
            right[p + j] = (x[j] - self.expected[j]) / width;
        }
        if p > 0 {
            triangularise(stacked.as_mut_slice(), 2 * p, &mut right);
        }
        let root = inverse_of_upper(&stacked);
        let step = |i: usize| -(i..p).map(|j| root[(i, j)] * right[j]).sum::<f64>();
        let variance = |j: usize| root.row(j).norm_squared();
        let taken = |j: usize| 1.0 - variance(j) / (evidence.widths[j] * evidence.widths[j]);
        let share = |j: usize| match self.is_flat[j] {
            true => (1.0 - variance(j)).max(0.0),
            false => taken(j),
        };
        Posterior {
            step: (0..p).map(step).collect(),
            data_share: (0..p).map(share).collect(),
            n_determined: (0..p).map(taken).sum(),
            root,
        }
    }

    /// Noise of the rows at a solution, mm.
    pub fn noise_mm(&self, problem: &Problem<'_>, posterior: &Posterior) -> f64 {
        let left = self.left(&posterior.step);
        match problem.usual_sigma_mm {
            None => (left / self.freedom(posterior)).sqrt(),
            Some(usual_mm) => {
                let freedom = self.n_rows as f64 - posterior.n_determined;
                let terms = [(left, 0.0, usual_mm * usual_mm)];
                probable_variance_over_usual(&terms, freedom).sqrt() * usual_mm
            }
        }
    }

    /// Number of rows minus the number of coordinates that they determine, at least 1.
    pub fn freedom(&self, posterior: &Posterior) -> f64 {
        (self.n_rows as f64 - posterior.n_determined).max(1.0)
    }

    /// Sum of squares of the rows after a step, mm².
    fn left(&self, step: &[f64]) -> f64 {
        let p = step.len();
        let row = |i: usize| self.right[i] + (i..p).map(|j| self.r[(i, j)] * step[j]).sum::<f64>();
        self.rest + (0..p).map(|i| row(i) * row(i)).sum::<f64>()
    }

    /// Noise and widths of the linear problem, beginning at `evidence`. The noise is at least `least_sigma_mm`.
    pub fn evidence(
        &self,
        problem: &Problem<'_>,
        x: &[f64],
        mut evidence: Evidence,
        least_sigma_mm: f64,
    ) -> Evidence {
        for _ in 0..UPDATES {
            let next = evidence.updated(self, problem, x, least_sigma_mm);
            let is_found = next.is_near(&evidence, CONVERGED);
            evidence = next;
            if is_found {
                break;
            }
        }
        evidence
    }
}

/// Inverse of the upper triangle in the first rows of a matrix.
fn inverse_of_upper(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let p = matrix.ncols();
    let mut inverse = DMatrix::zeros(p, p);
    for column in 0..p {
        inverse[(column, column)] = 1.0 / matrix[(column, column)];
        for row in (0..column).rev() {
            let sum: f64 = (row + 1..=column)
                .map(|k| matrix[(row, k)] * inverse[(k, column)])
                .sum();
            inverse[(row, column)] = -sum / matrix[(row, row)];
        }
    }
    inverse
}
