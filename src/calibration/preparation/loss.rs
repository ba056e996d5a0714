//! Losses that outliers cannot pull far, for least squares and the swarm alike.

use crate::calibration::preparation::screening::{Screening, loss};
use crate::calibration::request::{CalibrationRequest, Loss};
use crate::identification::KinematicModel;
use crate::identification::estimate::FitSummary;
use crate::identification::objective::{Observation, residuals, squared_rows_mm2};
use crate::identification::pose_rows::{MeasuredRotation, rotation_residual_rad};
use crate::kinematics::batch::Bound;
use crate::kinematics::rotation::rotation_exp;
use crate::solvers::least_squares::{Iteration, Termination};
use crate::solvers::loss::{self as losses, HUBER_K_95, TUKEY_C_95};
use std::ops::ControlFlow;

/// Reweightings at most; a handful is usual.
const MAX_REWEIGHTINGS: usize = 50;
/// A reweighting that lowers F by less than this share is the last.
const SMALLEST_GAIN: f64 = 1e-10;
/// Where the pull of so few points still grows with their distance, there is no minimum to speak of.
const SMALLEST_SLOPE: f64 = 0.05;

/// How the residual of a point counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointLoss {
    /// Its weighted square.
    Squares,
    /// s²·ρ(e/s), with e the weighted residual's length and s the standard deviation of a coordinate.
    Bounded {
        /// ρ.
        loss: losses::Loss,
        /// s, mm.
        scale_mm: f64,
    },
}

impl PointLoss {
    /// The request's, at the scale that screening found.
    pub fn of(request: &CalibrationRequest, screening: &Screening) -> Self {
        let scale_mm = screening.scale_mm;
        match loss(request, screening) {
            Loss::Squares => Self::Squares,
            Loss::Huber => Self::Bounded {
                loss: losses::Loss::Huber { k: HUBER_K_95 },
                scale_mm,
            },
            Loss::Tukey => Self::Bounded {
                loss: losses::Loss::Tukey { c: TUKEY_C_95 },
                scale_mm,
            },
        }
    }

    /// As the swarm's kernel wants it. Tukey's loss is flat a few standard deviations out, where a swarm begins: it would see no slope. It
    /// searches with Huber's, and what refines it ends with Tukey's.
    pub fn bound(self) -> Option<Bound> {
        match self {
            Self::Bounded {
                loss: losses::Loss::Huber { k },
                scale_mm,
            } => Some(Bound::Huber { k_mm: k * scale_mm }),
            Self::Bounded {
                loss: losses::Loss::Tukey { .. },
                scale_mm,
            } => Some(Bound::Huber {
                k_mm: HUBER_K_95 * scale_mm,
            }),
            _ => None,
        }
    }

    /// F of a model, mm².
    pub fn cost(self, model: &KinematicModel, observations: &[Observation]) -> f64 {
        let lengths = lengths(model, observations);
        match self {
            Self::Squares => lengths.iter().map(|e| e * e).sum(),
            Self::Bounded { loss, scale_mm } => lengths
                .iter()
                .map(|e| scale_mm * scale_mm * loss.rho(e / scale_mm))
                .sum(),
        }
    }

    /// The observations with the weights that the loss gives them at a model.
    pub fn reweighted(
        self,
        model: &KinematicModel,
        observations: &[Observation],
    ) -> Vec<Observation> {
        let factor = |e: f64| match self {
            Self::Squares => 1.0,
            Self::Bounded { loss, scale_mm } => loss.weight(e / scale_mm),
        };
        let lengths = lengths(model, observations);
        observations
            .iter()
            .zip(lengths)
            .map(|(o, e)| Observation {
                weight: o.weight * factor(e),
                ..o.clone()
            })
            .collect()
    }

    /// The points of which least squares has the same minimum and the covariance of this estimate: each residual e replaced by ψ(e) / m, m the
    /// mean slope of ψ. What it says of them, σ²·(JᵀJ)⁻¹ with σ² = Σψ² / ((N − p)·m²), is the covariance of an M-estimate [Huber 1981,
    /// section 7.6, without the factor K].
    pub fn as_squares(
        self,
        model: &KinematicModel,
        observations: &[Observation],
    ) -> Vec<Observation> {
        let Self::Bounded { loss, scale_mm } = self else {
            return observations.to_vec();
        };
        let lengths: Vec<f64> = lengths(model, observations)
            .iter()
            .map(|e| e / scale_mm)
            .collect();
        let counting = observations.iter().filter(|o| o.weight > 0.0).count() as f64;
        let slopes = observations
            .iter()
            .zip(&lengths)
            .filter(|(o, _)| o.weight > 0.0)
            .map(|(_, s)| loss.mean_slope(*s));
        let mean_slope = slopes.sum::<f64>() / counting.max(1.0);
        if !(scale_mm > 0.0 && mean_slope > SMALLEST_SLOPE) {
            return observations.to_vec();
        }
        let factors = lengths.iter().map(|s| loss.weight(*s) / mean_slope - 1.0);
        observations
            .iter()
            .zip(residuals(model, observations))
            .zip(factors)
            .map(|((o, e), factor)| Observation {
                position_mm: o.position_mm + e * factor,
                rotation: pulled_rotation(model, o, factor),
                ..o.clone()
            })
            .collect()
    }
}

/// A measured rotation with its residual 1 + `factor` times as large.
fn pulled_rotation(
    model: &KinematicModel,
    o: &Observation,
    factor: f64,
) -> Option<MeasuredRotation> {
    let measured = o.rotation?;
    let Some(predicted) = model.rotation(&o.q_rad, o.target) else {
        return Some(measured);
    };
    let w = rotation_residual_rad(&predicted, &measured);
    Some(MeasuredRotation {
        rotation: measured.rotation * rotation_exp(&(w * factor)),
        ..measured
    })
}

/// Length of each weighted residual, mm; of poses, rotation rows included.
fn lengths(model: &KinematicModel, observations: &[Observation]) -> Vec<f64> {
    let length = |o: &Observation| o.weight.sqrt() * squared_rows_mm2(model, o).sqrt();
    observations.iter().map(length).collect()
}

/// Least squares, of points with any weights.
pub struct LeastSquares<'a> {
    /// Fits the points from a start on.
    pub fit: &'a dyn Fn(&KinematicModel, &[Observation]) -> FitSummary,
    /// What the request's priors add to F of a model, mm².
    pub prior_cost_mm2: &'a dyn Fn(&KinematicModel) -> f64,
}

/// Iteratively reweighted least squares [Holland & Welsch 1977]. An iteration is a reweighting; F, the sum of the
/// losses, falls with each. A loss that forgets outliers
/// altogether has many minima: it begins at the fit to the `trusted` points, those that screening found to belong together.
pub fn robust_fit(
    start: &KinematicModel,
    least_squares: &LeastSquares<'_>,
    observations: &[Observation],
    trusted: &[Observation],
    loss: PointLoss,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> FitSummary {
    let mut start = start.clone();
    let n_evaluations = approach(&mut start, least_squares, trusted, loss);
    let cost_of = |model: &KinematicModel| {
        loss.cost(model, observations) + (least_squares.prior_cost_mm2)(model)
    };
    let cost = cost_of(&start);
    let termination = Termination::IterationLimit;
    let mut found = FitSummary {
        model: start,
        n_iterations: 0,
        n_evaluations,
        convergence_mm2: vec![cost],
        termination,
    };
    while found.n_iterations < MAX_REWEIGHTINGS {
        let before = found.convergence_mm2[found.n_iterations];
        let told = Iteration {
            iteration: found.n_iterations,
            max_iterations: MAX_REWEIGHTINGS,
            cost: before,
        };
        if monitor(told).is_break() {
            return FitSummary {
                termination: Termination::Stopped,
                ..found
            };
        }
        let reweighted = loss.reweighted(&found.model, observations);
        let fit = (least_squares.fit)(&found.model, &reweighted);
        let after = cost_of(&fit.model);
        found.n_iterations += 1;
        found.n_evaluations += fit.n_evaluations;
        found.convergence_mm2.push(before.min(after));
        if after < before {
            found.model = fit.model;
        }
        if after > before * (1.0 - SMALLEST_GAIN) {
            found.termination = Termination::CostTolerance;
            break;
        }
    }
    found
}

/// From a start whose residuals are far above the scale, the weights of nearly all points would be small and mean little: the scale is
/// brought down to its value step by step. The evaluations that took.
fn approach(
    start: &mut KinematicModel,
    least_squares: &LeastSquares<'_>,
    observations: &[Observation],
    loss: PointLoss,
) -> usize {
    let PointLoss::Bounded { loss, scale_mm } = loss else {
        return 0;
    };
    if matches!(loss, losses::Loss::Tukey { .. }) {
        let fit = (least_squares.fit)(start, observations);
        *start = fit.model;
        return fit.n_evaluations;
    }
    let rms =
        (PointLoss::Squares.cost(start, observations) / observations.len().max(1) as f64).sqrt();
    let (mut at, mut n_evaluations) = (rms, 1);
    while at > SCALE_STEP * scale_mm && at > 0.0 {
        let reweighted = PointLoss::Bounded { loss, scale_mm: at }.reweighted(start, observations);
        let fit = (least_squares.fit)(start, &reweighted);
        (*start, n_evaluations) = (fit.model, n_evaluations + fit.n_evaluations);
        at /= SCALE_STEP;
    }
    n_evaluations
}

/// Factor between the scales on the way.
const SCALE_STEP: f64 = 3.0;
