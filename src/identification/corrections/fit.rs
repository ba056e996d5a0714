//! Maximum a posteriori fit of links and corrections together, with a prior for each number, by Gauss-Newton steps.
//!
//! Minimises F + σ²·Σ (x/S)². x are the corrections and the parameters' deviations from nominal. S is the expected size of each, as found by the fit
//! of the links alone. σ² is the variance of a coordinate about the model. It is estimated from the fit, with the degrees of freedom that the fit
//! uses up.

use super::linear::{linearise, rotation_rows};
use super::{Term, corrections_at};
use crate::identification::KinematicModel;
use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, apply, deviation_from};
use crate::identification::priors::Prior;
use crate::kinematics::{Corrections, Mounting, Payload, reach_mm};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Number of Gauss-Newton steps. The links are already identified and corrections are nearly linear, so that each step reduces the error to a
/// thousandth.
const STEPS: usize = 4;

/// Everything that stays the same from fit to fit.
pub struct Setting<'a> {
    /// The nominal robot.
    pub nominal: &'a KinematicModel,
    /// Gravity.
    pub mounting: Mounting,
    /// Payload on the flange, if known.
    pub payload: Option<Payload>,
    /// The free parameters of links, base and targets.
    pub parameters: &'a [Parameter],
    /// Their scales, mm or rad.
    pub scale: &'a [f64],
    /// Prior of each parameter.
    pub priors: &'a [Prior],
    /// The points, each with nonzero weight.
    pub observations: &'a [Observation],
}

/// A fit of links with some corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Base, links and targets.
    pub model: KinematicModel,
    /// The free terms of the corrections.
    pub terms: Vec<Term>,
    /// Values of the terms.
    pub values: Vec<f64>,
    /// σ², mm².
    pub variance: f64,
}

/// The linear problem at a fit: residuals ≈ `residuals` − `columns`·x, with the priors as further rows.
pub struct Linear {
    /// 3·N + 3·M, weighted: the positions of all observations, then the rotations of the poses among them.
    pub residuals: DVector<f64>,
    /// First rotation row of each observation that is a pose.
    pub rotation_rows: Vec<Option<usize>>,
    /// (3·N + 3·M) × m: links, base and targets in units of their scales, then the terms in units of their priors.
    pub columns: DMatrix<f64>,
    /// The diagonal of Λ, m: Σ (x/S)² = (x − pulled)ᵀ·Λ·(x − pulled) up to a constant.
    pub prior: DVector<f64>,
    /// Λ·pulled, m.
    pub pull: DVector<f64>,
}

impl Setting<'_> {
    /// The corrections at a fit.
    pub fn corrections(&self, fitted: &Fitted) -> Corrections {
        let mut corrections = corrections_at(
            self.nominal.links.len(),
            &self.mounting,
            &fitted.terms,
            &fitted.values,
        );
        corrections.compliance.payload = self.payload;
        corrections
    }

    /// The linear problem at a fit. Every parameter is free. The links' priors settle what the points cannot tell apart, so that base and targets
    /// absorb as much as they can.
    pub fn linear(&self, at: &Fitted) -> Linear {
        let corrections = self.corrections(at);
        let unknowns = (self.parameters, at.terms.as_slice());
        let (residuals, mut by_parameter, mut by_term) = linearise(
            &at.model,
            &corrections,
            &self.mounting,
            unknowns,
            self.observations,
        );
        let (p, k) = (self.parameters.len(), at.terms.len());
        for (j, scale) in self.scale.iter().enumerate() {
            by_parameter.column_mut(j).scale_mut(*scale);
        }
        // limits a step of poorly observable parameters to their scale
        let (mut prior, mut pull) = (
            DVector::<f64>::repeat(p + k, 1.0),
            DVector::<f64>::zeros(p + k),
        );
        for known in self.priors {
            let j = known.parameter;
            let deviation = deviation_from(self.nominal, &at.model, &self.parameters[j]);
            let scale = self.scale[j] / known.std;
            prior[j] += scale * scale;
            pull[j] += scale * (known.mean - deviation) / known.std;
        }
        let reach_mm = reach_mm(&self.nominal.links);
        for (j, (term, value)) in at.terms.iter().zip(&at.values).enumerate() {
            let width = term.prior(&self.mounting, reach_mm);
            by_term.column_mut(j).scale_mut(width);
            pull[p + j] = -value / width;
        }
        let mut columns = DMatrix::zeros(residuals.len(), p + k);
        columns.columns_mut(0, p).copy_from(&by_parameter);
        columns.columns_mut(p, k).copy_from(&by_term);
        Linear {
            rotation_rows: rotation_rows(&at.model, self.observations),
            residuals,
            columns,
            prior,
            pull,
        }
    }
}

impl Linear {
    /// The rows of one observation.
    pub fn rows_of(&self, observation: usize) -> impl Iterator<Item = usize> + use<> {
        let of_rotation = self.rotation_rows[observation].map(|row| row..row + 3);
        (3 * observation..3 * observation + 3).chain(of_rotation.into_iter().flatten())
    }

    /// x of the maximum a posteriori solution, from the normal matrix AᵀA and Aᵀr of some of the rows.
    pub fn solve(
        &self,
        normal: DMatrix<f64>,
        right: DVector<f64>,
        variance: f64,
    ) -> Option<DVector<f64>> {
        self.solved(normal, right, variance).map(|(x, _)| x)
    }

    fn solved(
        &self,
        normal: DMatrix<f64>,
        right: DVector<f64>,
        variance: f64,
    ) -> Option<(DVector<f64>, Cholesky<f64, Dyn>)> {
        let mut posterior = normal;
        posterior.set_diagonal(&(posterior.diagonal() + &self.prior * variance));
        let cholesky = posterior.cholesky()?;
        let x = cholesky.solve(&(right + &self.pull * variance));
        x.iter().all(|v| v.is_finite()).then_some((x, cholesky))
    }
}

/// Fits links and `terms`, beginning at `start`. Terms that `start` already has begin at their values there.
pub fn fit(setting: &Setting<'_>, start: &Fitted, terms: &[Term]) -> Option<Fitted> {
    let known = |term: &Term| {
        start
            .terms
            .iter()
            .position(|t| t == term)
            .map_or(0.0, |i| start.values[i])
    };
    let mut at = Fitted {
        terms: terms.to_vec(),
        values: terms.iter().map(known).collect(),
        ..start.clone()
    };
    for _ in 0..STEPS {
        let linear = setting.linear(&at);
        let normal = linear.columns.tr_mul(&linear.columns);
        let right = linear.columns.tr_mul(&linear.residuals);
        let (x, cholesky) = linear.solved(normal, right, at.variance)?;
        let p = setting.parameters.len();
        let deviations = setting.scale.iter().zip(&x).map(|(scale, x)| scale * x);
        let deviations: Vec<f64> = deviations.collect();
        at.model = apply(&at.model, setting.parameters, &deviations);
        for (j, term) in terms.iter().enumerate() {
            at.values[j] +=
                x[p + j] * term.prior(&setting.mounting, reach_mm(&setting.nominal.links));
        }
        // degrees of freedom used up: trace((AᵀA + σ²Λ)⁻¹·AᵀA)
        let used = x.len() as f64 - at.variance * cholesky.inverse().diagonal().dot(&linear.prior);
        let left = (&linear.residuals - &linear.columns * &x).norm_squared();
        at.variance = left / (linear.residuals.len() as f64 - used).max(1.0);
    }
    at.variance.is_finite().then_some(at)
}
