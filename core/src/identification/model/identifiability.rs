//! What the data determine: singular values of the scaled identification Jacobian, its rank, and its null space by parameter names.

use crate::identification::model::parameters::Parameter;
use crate::solvers::orthonormal::{MIN_ROWS, triangle};
use crate::solvers::products::side_by_side;
use crate::solvers::qr::triangularise;
use nalgebra::{DMatrix, DVector};

/// A combination is observable if a change by its prior scale displaces the measured points by at least this share of the reach, rms: 1 µm on an arm
/// of 1.7 m, a tenth of the resolution of the best trackers. Below it, the data only add noise to the combination.
pub const VISIBLE_PER_REACH: f64 = 1e-3 / 1700.0;
/// A parameter belongs to an unobservable combination if its share is at least this share of the largest one.
const MIN_SHARE: f64 = 1e-3;
/// Priors determine a combination if they are at most a thousand times wider than the usual errors of robots, and if their parameter's
/// share in the combination is at least this.
const MIN_PRIOR_RATIO: f64 = 1e-3;
/// Iteration limit of the singular value decomposition.
const SVD_ITERATIONS: usize = 10_000;

/// Expected error of a length as a share of the reach: 1 mm on an arm of 1.7 m (one standard deviation of a new robot).
const LENGTH_PER_REACH: f64 = 1.0 / 1700.0;
/// Expected error of an angle, rad (0.3°).
pub const PRIOR_ANGLE_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Ratio of the expected errors of base and target lengths, after their first estimate, to those of link lengths.
pub const PLACEMENT_PER_LENGTH: f64 = 10.0;

/// Prior scale of a parameter of an arm of this reach, mm or rad.
pub fn prior_scale(parameter: &Parameter, reach_mm: f64) -> f64 {
    let length_mm = LENGTH_PER_REACH * reach_mm;
    match parameter {
        _ if parameter.is_angle() => PRIOR_ANGLE_RAD,
        Parameter::Link(..) => length_mm,
        _ => PLACEMENT_PER_LENGTH * length_mm,
    }
}

/// [`prior_scale`] of each parameter.
pub fn prior_scales(parameters: &[Parameter], reach_mm: f64) -> Vec<f64> {
    let scale = |parameter| prior_scale(parameter, reach_mm);
    parameters.iter().map(scale).collect()
}

/// Singular value decomposition of the scaled Jacobian: J·S = U·Σ·Vᵀ.
#[derive(Clone, Debug, PartialEq)]
pub struct Decomposition {
    /// Singular values, largest first, of J·S divided by sqrt(N points): rms displacement in mm per prior scale.
    pub singular_values: Vec<f64>,
    /// V, p × p; column k belongs to singular value k.
    pub directions: DMatrix<f64>,
    /// S: the scale of each parameter.
    pub scale: Vec<f64>,
    /// Smallest singular value of an observable combination, mm: [`VISIBLE_PER_REACH`].
    pub visible_mm: f64,
}

/// Decomposes J·S / sqrt(N points), with its rows in any order.
pub fn decompose(mut scaled: DMatrix<f64>, scale: &[f64], visible_mm: f64) -> Decomposition {
    let p = scale.len();
    if scaled.nrows() < p {
        scaled = scaled.resize_vertically(p, 0.0);
    }
    // The R of the QR factorisation of J·S has the same singular values and right singular vectors, and only p × p entries.
    let n_rows = scaled.nrows();
    if n_rows > MIN_ROWS {
        scaled = triangle(&scaled);
    } else if p > 0 {
        triangularise(scaled.as_mut_slice(), n_rows, &mut vec![0.0; n_rows]);
    }
    let square = DMatrix::from_fn(p, p, |row, column| {
        if row <= column {
            scaled[(row, column)]
        } else {
            0.0
        }
    });
    let (values, v_t) = match square.try_svd(false, true, f64::EPSILON, SVD_ITERATIONS) {
        Some(svd) => (
            svd.singular_values,
            svd.v_t.unwrap_or_else(|| DMatrix::identity(p, p)),
        ),
        None => (DVector::zeros(p), DMatrix::identity(p, p)),
    };
    let mut order: Vec<usize> = (0..p).collect();
    order.sort_by(|i, j| values[*j].total_cmp(&values[*i]).then(i.cmp(j)));
    let directions = DMatrix::from_fn(p, p, |row, k| v_t[(order[k], row)]);
    Decomposition {
        singular_values: order.iter().map(|k| values[*k]).collect(),
        directions: with_fixed_signs(directions),
        scale: scale.to_vec(),
        visible_mm,
    }
}

/// Fixes the arbitrary signs of singular vectors: the largest entry becomes positive, so that equal data give equal directions.
fn with_fixed_signs(mut directions: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in directions.column_iter_mut() {
        if column[column.iamax()] < 0.0 {
            column.neg_mut();
        }
    }
    directions
}

impl Decomposition {
    /// Number of combinations that the data determine.
    pub fn rank(&self) -> usize {
        self.singular_values
            .iter()
            .filter(|s| **s >= self.visible_mm)
            .count()
    }

    /// Rank by a threshold relative to the largest singular value, for questions about the model alone.
    pub fn rank_relative(&self, tolerance: f64) -> usize {
        let largest = self.singular_values.first().copied().unwrap_or(0.0);
        self.singular_values
            .iter()
            .filter(|s| **s > tolerance * largest)
            .count()
    }

    /// Largest over smallest observable singular value.
    pub fn condition_number(&self) -> f64 {
        match self.rank() {
            0 => f64::INFINITY,
            rank => self.singular_values[0] / self.singular_values[rank - 1],
        }
    }

    /// O1 = (σ1 … σr)^(1/r) / sqrt(N) over the observable combinations (Borm & Menq 1991). The σ used here already contain 1/sqrt(N).
    pub fn observability_index_o1(&self) -> f64 {
        let rank = self.rank();
        if rank == 0 {
            return 0.0;
        }
        libm::exp(
            self.singular_values[..rank]
                .iter()
                .map(|s| libm::log(*s))
                .sum::<f64>()
                / rank as f64,
        )
    }

    /// S·V of the observable combinations, p × rank: deviation = this · coordinates.
    pub fn observable_directions(&self) -> DMatrix<f64> {
        let rank = self.rank();
        DMatrix::from_fn(self.scale.len(), rank, |row, k| {
            self.scale[row] * self.directions[(row, k)]
        })
    }

    /// S·V of the unobservable combinations, p × (p − rank).
    pub fn unobservable_directions(&self) -> DMatrix<f64> {
        let rank = self.rank();
        let p = self.scale.len();
        DMatrix::from_fn(p, p - rank, |row, k| {
            self.scale[row] * self.directions[(row, rank + k)]
        })
    }

    /// As [`Self::observable_directions`] and [`Self::unobservable_directions`], but unobservable combinations that priors determine are moved to the first
    /// group. `stds` has parameters and the standard deviations of their priors, mm or rad.
    pub fn directions_with_priors(&self, stds: &[(usize, f64)]) -> (DMatrix<f64>, DMatrix<f64>) {
        let (seen, unseen) = (self.observable_directions(), self.unobservable_directions());
        if stds.is_empty() || unseen.ncols() == 0 {
            return (seen, unseen);
        }
        // A prior does not determine a combination that does not contain its parameter, however narrow it is.
        let prior_rows = |row: usize, k: usize| {
            unseen[(stds[row].0, k)]
                / stds[row]
                    .1
                    .max(self.scale[stds[row].0])
                    .max(f64::MIN_POSITIVE)
        };
        let prior_rows = DMatrix::from_fn(stds.len(), unseen.ncols(), prior_rows);
        let by_prior = decompose(prior_rows, &vec![1.0; unseen.ncols()], 0.0);
        let n_prior_rows = by_prior
            .singular_values
            .iter()
            .filter(|s| **s >= MIN_PRIOR_RATIO)
            .count();
        let turned = unseen * &by_prior.directions;
        let known = side_by_side(&[&seen, &turned.columns(0, n_prior_rows).into_owned()]);
        (known, turned.columns_range(n_prior_rows..).into_owned())
    }

    /// The unobservable combinations, each as the indices of its parameters. The null space is first reduced to echelon form, so that each
    /// combination has as few parameters as possible.
    pub fn unseen_groups(&self) -> Vec<Vec<usize>> {
        let p = self.scale.len();
        let rank = self.rank();
        let mut rows = self.directions.columns(rank, p - rank).transpose();
        reduce_rows(&mut rows);
        let mut groups: Vec<Vec<usize>> = rows
            .row_iter()
            .map(|row| {
                let largest = row.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                (0..p)
                    .filter(|j| row[*j].abs() >= MIN_SHARE * largest)
                    .collect()
            })
            .collect();
        groups.sort();
        groups
    }
}

/// Gauss-Jordan elimination with complete pivoting.
fn reduce_rows(rows: &mut DMatrix<f64>) {
    for k in 0..rows.nrows() {
        let (mut pivot_row, mut pivot_column) = (k, 0);
        for row in k..rows.nrows() {
            for column in 0..rows.ncols() {
                if rows[(row, column)].abs() > rows[(pivot_row, pivot_column)].abs() {
                    (pivot_row, pivot_column) = (row, column);
                }
            }
        }
        if rows[(pivot_row, pivot_column)].abs() < MIN_SHARE {
            return;
        }
        rows.swap_rows(k, pivot_row);
        let pivot = rows[(k, pivot_column)];
        rows.row_mut(k).unscale_mut(pivot);
        for other in (0..rows.nrows()).filter(|r| *r != k) {
            let factor = rows[(other, pivot_column)];
            let eliminated = rows.row(other) - rows.row(k) * factor;
            rows.row_mut(other).copy_from(&eliminated);
        }
    }
}
