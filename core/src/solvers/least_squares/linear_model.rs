//! The linearised problem, min ‖r + J·p‖ over ‖D·p‖ ≤ Δ, reduced to a triangle.

use super::directions::{Directions, RADIUS_TOLERANCE, SMALLEST_SINGULAR_VALUE};
use super::minimum_norm::MinimumNorm;
use crate::solvers::qr::norm;
use crate::solvers::qr::triangularise;
use multiversion::multiversion;
use nalgebra::DMatrix;

/// A triangle needs no decomposition if its singular values are certainly above this multiple of [`SMALLEST_SINGULAR_VALUE`] of the largest.
const CERTAIN_FACTOR: f64 = 100.0;

/// T = R·D⁻¹ and b = Qᵀr with J = Q·R: the step is p = D⁻¹·w with w minimising ‖T·w + b‖.
pub(super) struct LinearModel {
    /// T, n × n, column-major; zero below the diagonal.
    triangle: Vec<f64>,
    /// b in its first n entries.
    qt_residuals: Vec<f64>,
    /// The Jacobian with rows of zeros, if there are fewer residuals than parameters.
    padded: Vec<f64>,
    /// The shortest minimiser of ‖T·w + b‖, and ‖T·w‖ there; `None` if the rank of T is not clear.
    undamped: Vec<f64>,
    undamped_change: Option<f64>,
    minimum_norm: MinimumNorm,
    /// Computed when first needed.
    directions: Option<Directions>,
    /// p.
    step: Vec<f64>,
}

/// The chosen step. Its vector is in [`LinearModel::step`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// λ.
    pub damping: f64,
    /// ‖D·p‖.
    pub length: f64,
    /// ‖J·p‖².
    pub change: f64,
}

impl LinearModel {
    /// Allocates buffers for a problem's linearisations.
    pub fn new(n_residuals: usize, n: usize) -> Self {
        let n_rows = n_residuals.max(n);
        Self {
            triangle: vec![0.0; n * n],
            qt_residuals: vec![0.0; n_rows],
            padded: if n_rows > n_residuals {
                vec![0.0; n_rows * n]
            } else {
                vec![]
            },
            undamped: vec![0.0; n],
            undamped_change: None,
            minimum_norm: MinimumNorm::new(n),
            directions: None,
            step: vec![0.0; n],
        }
    }

    /// Reduces a linearisation; the Jacobian is overwritten.
    pub fn reduce(&mut self, jacobian: &mut DMatrix<f64>, residuals: &[f64], scale: &[f64]) {
        let n = scale.len();
        self.directions = None;
        self.qt_residuals[..residuals.len()].copy_from_slice(residuals);
        self.qt_residuals[residuals.len()..].fill(0.0);
        let n_rows = self.qt_residuals.len();
        if n == 0 || n_rows == 0 {
            return;
        }
        let matrix = if self.padded.is_empty() {
            jacobian.as_mut_slice()
        } else {
            padded(jacobian, n_rows, &mut self.padded)
        };
        triangularise(matrix, n_rows, &mut self.qt_residuals);
        for (j, scale) in scale.iter().enumerate() {
            for i in 0..=j {
                self.triangle[j * n + i] = matrix[j * n_rows + i] / scale;
            }
        }
        self.undamped.copy_from_slice(&self.qt_residuals[..n]);
        self.undamped_change = if solve(&self.triangle, &mut self.undamped) {
            Some(norm(&self.qt_residuals[..n])) // T·w = −b
        } else {
            self.minimum_norm
                .solve(&self.triangle, &self.qt_residuals[..n], &mut self.undamped)
        };
    }

    /// λ and p. λ = 0 if that step is not longer than Δ. Otherwise λ is such that the step's length is Δ to 10 %; the search for λ begins at `guess`.
    /// `None` if a decomposition fails, which is not known to happen for any finite matrix.
    pub fn step_within(&mut self, radius: f64, guess: f64, scale: &[f64]) -> Option<Step> {
        if let Some(change) = self.undamped_change {
            let length = norm(&self.undamped);
            if length <= (1.0 + RADIUS_TOLERANCE) * radius {
                for ((p, w), scale) in self.step.iter_mut().zip(&self.undamped).zip(scale) {
                    *p = w / scale;
                }
                return Some(Step {
                    damping: 0.0,
                    length,
                    change: change * change,
                });
            }
        }
        if self.directions.is_none() {
            self.directions =
                Directions::of(&self.triangle, &self.qt_residuals[..scale.len()], scale);
        }
        let directions = self.directions.as_ref()?;
        let (damping, w) = directions.step_within(radius, guess);
        self.step.fill(0.0);
        for (column, w) in directions.unscaled.column_iter().zip(&w) {
            for (p, v) in self.step.iter_mut().zip(column.iter()) {
                *p += v * w;
            }
        }
        Some(Step {
            damping,
            length: norm(&w),
            change: directions.change(&w),
        })
    }

    /// p.
    pub fn step(&self) -> &[f64] {
        &self.step
    }
}

/// The Jacobian with rows of zeros appended.
fn padded<'a>(jacobian: &DMatrix<f64>, n_rows: usize, padded: &'a mut [f64]) -> &'a mut [f64] {
    let m = jacobian.nrows();
    for (j, to) in padded.chunks_exact_mut(n_rows).enumerate() {
        to[..m].copy_from_slice(jacobian.column(j).as_slice());
        to[m..].fill(0.0);
    }
    padded
}

/// Solves T·w = −b in place by back-substitution. Returns false if T may be singular; w is then not valid.
///
/// If the columns of T have at most norm one, its largest singular value is at most sqrt(n). Its smallest is at least 1 / (sqrt(n)·‖T⁻¹‖∞). ‖T⁻¹‖∞ is
/// at most ‖x‖∞ with M(T)·x = (1, …, 1), where M(T) has |t_jj| on and −|t_ij| off the diagonal [Higham, Accuracy and Stability of Numerical
/// Algorithms, 2002, theorem 8.12].
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn solve(triangle: &[f64], b: &mut [f64]) -> bool {
    const MAX_COLUMNS: usize = 256;
    let n = b.len();
    let largest = 1.0 / (CERTAIN_FACTOR * SMALLEST_SINGULAR_VALUE * n as f64);
    let mut bounds = [1.0; MAX_COLUMNS];
    if n > MAX_COLUMNS {
        return false;
    }
    for j in (0..n).rev() {
        let column = &triangle[j * n..j * n + j + 1];
        let diagonal = column[j];
        bounds[j] /= diagonal.abs();
        if bounds[j].is_nan() || bounds[j] > largest {
            return false;
        }
        b[j] = -b[j] / diagonal;
        let (w, bound) = (b[j], bounds[j]);
        for i in 0..j {
            b[i] = column[i].mul_add(w, b[i]);
            bounds[i] = column[i].abs().mul_add(bound, bounds[i]);
        }
    }
    true
}
