//! Robust losses for least squares and the swarm. They limit the influence of outliers.

use crate::calibration::preparation::screening::{Screening, loss};
use crate::calibration::request::{CalibrationRequest, Loss};
use crate::calibration::{Error, unusable};
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::FitSummary;
use crate::identification::model::objective::{
    Observation, composed_motions, squared_rows_mm2, with_stations_moved,
};
use crate::identification::model::pose_rows::{MeasuredRotation, rotation_residual_rad};
use crate::kinematics::batch::Bound;
use crate::kinematics::rotation::rotation_exp;
use crate::solvers::least_squares::{Iteration, Termination};
use crate::solvers::loss::{self as losses, HUBER_K_95, TUKEY_C_95};
use std::ops::ControlFlow;

/// Maximum number of reweightings; a handful is usual.
const MAX_REWEIGHTINGS: usize = 50;
/// Minimum relative decrease of F. A reweighting that gains less is the last.
const SMALLEST_GAIN: f64 = 1e-10;
/// Minimum mean slope of ψ. Below it, too few points have an influence that grows with their residual, and the minimum is not well defined.
const SMALLEST_SLOPE: f64 = 0.05;

/// Loss of a point's residual.
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
    /// The requested loss, with the scale from the screening.
    ///
    /// # Errors
    /// [`Error::Unusable`] with code `too_few_points_for_loss` if a robust loss was requested and the screening found no scale.
    pub fn of(request: &CalibrationRequest, screening: &Screening) -> Result<Self, Error> {
        let loss = match loss(request, screening) {
            Loss::Squares => return Ok(Self::Squares),
            Loss::Huber => losses::Loss::Huber { k: HUBER_K_95 },
            Loss::Tukey => losses::Loss::Tukey { c: TUKEY_C_95 },
        };
        let scale_mm = screening.scale_mm;
        if scale_mm <= 0.0 {
            let detail = "too few points for a robust loss: nothing shows the scatter of the points, beyond which the loss would limit their \
                          influence. Leave options.loss out, or measure more poses";
            return Err(unusable("too_few_points_for_loss", detail));
        }
        Ok(Self::Bounded { loss, scale_mm })
    }

    /// The loss for the swarm's kernel. Tukey's loss is flat beyond a few standard deviations, where a swarm starts, so the swarm uses
    /// Huber's loss instead. The refinement then uses Tukey's loss.
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

    /// Points for which least squares has the same minimum as this loss, and the covariance of the M-estimate. Each residual e is replaced by ψ(e) /
    /// m, with m the mean slope of ψ. The covariance of least squares on these points, σ²·(JᵀJ)⁻¹ with σ² = Σψ² / ((N − p)·m²), is that of an
    /// M-estimate [Huber 1981, section 7.6, without the factor K].
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
        let with_weight = observations.iter().filter(|o| o.weight > 0.0).count() as f64;
        let slopes = observations
            .iter()
            .zip(&lengths)
            .filter(|(o, _)| o.weight > 0.0)
            .map(|(_, s)| loss.mean_slope(*s));
        let mean_slope = slopes.sum::<f64>() / with_weight.max(1.0);
        if !(scale_mm > 0.0 && mean_slope > SMALLEST_SLOPE) {
            return observations.to_vec();
        }
        let factors = lengths.iter().map(|s| loss.weight(*s) / mean_slope - 1.0);
        observations
            .iter()
            .zip(factors)
            .map(|(o, factor)| Observation {
                position_mm: o.position_mm
                    + (o.position_mm - model.position(&o.q_rad, o.target)) * factor,
                rotation: pulled_rotation(model, o, factor),
                ..o.clone()
            })
            .collect()
    }
}

/// A measured rotation changed so that its residual is 1 + `factor` times as large.
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

/// Length of each weighted residual, mm. For poses, rotation rows are included.
fn lengths(model: &KinematicModel, observations: &[Observation]) -> Vec<f64> {
    let length = |o: &Observation| o.weight.sqrt() * squared_rows_mm2(model, o).sqrt();
    observations.iter().map(length).collect()
}

/// A least-squares fit of points with any weights.
pub struct LeastSquares<'a> {
    /// Fits the points from a start model.
    pub fit: &'a dyn Fn(&KinematicModel, &[Observation]) -> FitSummary,
    /// Cost of the request's priors at a model, mm². It is a part of F.
    pub prior_cost_mm2: &'a dyn Fn(&KinematicModel) -> f64,
}

/// Iteratively reweighted least squares [Holland & Welsch 1977]. Each iteration is one reweighting and lowers F, the sum of the losses. A
/// redescending loss (Tukey's) has many minima. It begins at the fit to the `trusted` points, which screening found to be consistent.
pub fn robust_fit(
    start: &KinematicModel,
    least_squares: &LeastSquares<'_>,
    observations: &[Observation],
    trusted: &[Observation],
    loss: PointLoss,
    monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
) -> FitSummary {
    let cost_of = |model: &KinematicModel, points: &[Observation]| {
        loss.cost(model, points) + (least_squares.prior_cost_mm2)(model)
    };
    let mut found = approach(start, least_squares, trusted, loss);
    let mut points = with_stations_moved(observations, &found.station_motions);
    found.convergence_mm2 = vec![cost_of(&found.model, &points)];
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
        let reweighted = loss.reweighted(&found.model, &points);
        let fit = (least_squares.fit)(&found.model, &reweighted);
        let moved = with_stations_moved(&points, &fit.station_motions);
        let after = cost_of(&fit.model, &moved);
        found.n_iterations += 1;
        found.n_evaluations += fit.n_evaluations;
        found.convergence_mm2.push(before.min(after));
        if after < before {
            found.model = fit.model;
            found.station_motions = composed_motions(&found.station_motions, &fit.station_motions);
            points = moved;
        }
        if after > before * (1.0 - SMALLEST_GAIN) {
            found.termination = Termination::CostTolerance;
            break;
        }
    }
    found
}

/// The start of the reweightings. The scale is lowered step by step to its final value: if the start's residuals were far above the scale, nearly
/// all weights would be small and carry little information.
fn approach(
    start: &KinematicModel,
    least_squares: &LeastSquares<'_>,
    observations: &[Observation],
    loss: PointLoss,
) -> FitSummary {
    let mut found = FitSummary {
        model: start.clone(),
        station_motions: vec![],
        n_iterations: 0,
        n_evaluations: 0,
        convergence_mm2: vec![],
        termination: Termination::IterationLimit,
    };
    let PointLoss::Bounded { loss, scale_mm } = loss else {
        return found;
    };
    if matches!(loss, losses::Loss::Tukey { .. }) {
        let fit = (least_squares.fit)(start, observations);
        return FitSummary {
            n_iterations: 0,
            termination: Termination::IterationLimit,
            ..fit
        };
    }
    let mut points = observations.to_vec();
    let rms = (PointLoss::Squares.cost(start, &points) / points.len().max(1) as f64).sqrt();
    found.n_evaluations = 1;
    let mut at = rms;
    while at > SCALE_STEP * scale_mm && at > 0.0 {
        let reweighted =
            PointLoss::Bounded { loss, scale_mm: at }.reweighted(&found.model, &points);
        let fit = (least_squares.fit)(&found.model, &reweighted);
        points = with_stations_moved(&points, &fit.station_motions);
        found.station_motions = composed_motions(&found.station_motions, &fit.station_motions);
        found.n_evaluations += fit.n_evaluations;
        found.model = fit.model;
        at /= SCALE_STEP;
    }
    found
}

/// Factor between successive scales.
const SCALE_STEP: f64 = 3.0;
