//! The trust region's step, along the singular directions of the scaled Jacobian.

use crate::solvers::qr::dot;
use crate::solvers::qr::norm;
use nalgebra::DMatrix;

/// Singular values of R·D⁻¹, relative to the largest, that count as zero. Jacobians are accurate to about 1e-15 of their columns, so a singular
/// vector below 1e-12 is mostly rounding.
pub(super) const SMALLEST_SINGULAR_VALUE: f64 = 1e-12;

/// Maximum number of iterations of the singular value decomposition per parameter; it takes two or three.
pub(super) const SVD_ITERATIONS_PER_PARAMETER: usize = 100;

/// Relative tolerance of the step's length about Δ [Moré 1978, σ].
pub(super) const RADIUS_TOLERANCE: f64 = 0.1;

/// Maximum number of tries to fit the step's length to Δ; MINPACK's limit. Two are usual.
const MAX_DAMPING_TRIES: usize = 10;

/// The linearised problem along its singular directions. With R·D⁻¹ = U·S·Vᵀ and D·p = V·w, it minimises Σ (σ_k w_k + b_k)², b = UᵀQᵀr. Unobservable
/// directions are left out.
pub(super) struct Directions {
    /// σ.
    singular_values: Vec<f64>,
    /// b, the residuals along each direction.
    along: Vec<f64>,
    /// D⁻¹·V, parameters × directions: p = D⁻¹·V·w.
    pub unscaled: DMatrix<f64>,
}

impl Directions {
    /// From the scaled triangle T = R·D⁻¹ (n × n, column-major) and Qᵀr. `None` if the decomposition fails, which is not known to happen for any
    /// finite matrix.
    pub fn of(triangle: &[f64], qt_residuals: &[f64], scale: &[f64]) -> Option<Self> {
        let n = scale.len();
        let matrix = DMatrix::from_column_slice(n, n, triangle);
        let svd = matrix.try_svd(
            true,
            true,
            f64::EPSILON,
            SVD_ITERATIONS_PER_PARAMETER * n.max(1),
        )?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let smallest = SMALLEST_SINGULAR_VALUE * svd.singular_values.max();
        let seen: Vec<usize> = (0..n)
            .filter(|&k| svd.singular_values[k] > smallest)
            .collect();
        Some(Self {
            singular_values: seen.iter().map(|&k| svd.singular_values[k]).collect(),
            along: seen
                .iter()
                .map(|&k| dot(u.column(k).as_slice(), qt_residuals))
                .collect(),
            unscaled: DMatrix::from_fn(n, seen.len(), |j, k| v_t[(seen[k], j)] / scale[j]),
        })
    }

    /// w(λ) = −σ b / (σ² + λ).
    fn step(&self, damping: f64) -> Vec<f64> {
        self.singular_values
            .iter()
            .zip(&self.along)
            .map(|(sigma, b)| -sigma * b / sigma.mul_add(*sigma, damping))
            .collect()
    }

    /// ‖J·p‖².
    pub fn change(&self, w: &[f64]) -> f64 {
        let change: Vec<f64> = self
            .singular_values
            .iter()
            .zip(w)
            .map(|(sigma, w)| sigma * w)
            .collect();
        dot(&change, &change)
    }

    /// λ and w(λ). λ = 0 if that step is not longer than Δ. Otherwise λ is such that the step's length is Δ to 10 %, by Newton's method on 1/Δ −
    /// 1/‖w(λ)‖ from `guess`, between bounds [Moré 1978, algorithm 5.5].
    pub fn step_within(&self, radius: f64, guess: f64) -> (f64, Vec<f64>) {
        let mut w = self.step(0.0);
        if norm(&w) <= (1.0 + RADIUS_TOLERANCE) * radius {
            return (0.0, w);
        }
        let mut lowest = self.newton_step(0.0, &w, radius);
        let gradient: Vec<f64> = self
            .singular_values
            .iter()
            .zip(&self.along)
            .map(|(sigma, b)| sigma * b)
            .collect();
        let mut highest = norm(&gradient) / radius;
        let mut damping = guess.clamp(lowest, highest.max(lowest));
        for _ in 0..MAX_DAMPING_TRIES {
            w = self.step(damping);
            let excess = norm(&w) - radius;
            if excess.abs() <= RADIUS_TOLERANCE * radius {
                break;
            }
            if excess > 0.0 {
                lowest = lowest.max(damping);
            } else {
                highest = highest.min(damping);
            }
            damping = (damping + self.newton_step(damping, &w, radius))
                .clamp(lowest, highest.max(lowest));
        }
        (damping, w)
    }

    /// (‖w‖ − Δ)/Δ · ‖w‖ / −d‖w‖/dλ.
    fn newton_step(&self, damping: f64, w: &[f64], radius: f64) -> f64 {
        let squares = dot(w, w);
        let slope = self
            .singular_values
            .iter()
            .zip(w)
            .fold(0.0, |sum: f64, (sigma, w)| {
                let curvature = sigma.mul_add(*sigma, damping);
                (w / curvature).mul_add(*w, sum)
            });
        (squares.sqrt() - radius) / radius * (squares / slope)
    }
}
