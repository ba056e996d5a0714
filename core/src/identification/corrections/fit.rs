//! Maximum a posteriori fit of links and corrections together, with a prior for each number, by Gauss-Newton steps.
//!
//! Minimises F + σ²·Σ (x/S)². x are the corrections and the parameters' deviations from nominal. S is the expected size of each, as found by the fit
//! of the links alone. σ² is the variance of a coordinate about the model. It is estimated from the fit, with the degrees of freedom that the fit
//! uses up. A step that does not lower this objective is halved [Nocedal & Wright 2006, section 10.3].

use super::linear::{linearise, rotation_rows};
use super::{Term, corrections_at};
use crate::identification::KinematicModel;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::{Parameter, apply, deviation_from};
use crate::identification::model::priors::Prior;
use crate::kinematics::rotation::rotation_exp;
use crate::kinematics::{Corrections, Mounting, Payload, reach_mm};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, IsometryMatrix3, Translation3, Vector3};
use std::borrow::Cow;

/// Maximum number of Gauss-Newton steps. A fit with many masses and compliances takes the most, because only their products are known.
const STEPS: usize = 60;
/// Minimum number of steps, so that the variance converges too.
const MIN_STEPS: usize = 4;
/// Maximum number of halvings of a step. If the step still does not lower the objective, the fit ends.
const HALVINGS: usize = 8;
/// The fit has converged when a step lowers the objective by less than this share.
const CONVERGED: f64 = 1e-6;
/// Prior precision of a number without a prior: one standard deviation is a thousand scales. It settles what no point shows, for example the
/// place of a target all of whose points are left out.
const FLAT: f64 = 1e-6;
/// Units of the motion of a set-up: rotation, rad, and shift as a share of the reach.
const MOTION_SCALE: f64 = 1e-3;

/// Everything that does not change between fits.
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
    /// Set-up of the instrument of each point; `None` in the reference set-up. Empty if there is one set-up only.
    pub set_ups: &'a [Option<usize>],
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
    /// Motion of each set-up except the reference: transforms its points from the placement of the links alone. That placement belongs to a
    /// robot without corrections, so it changes when corrections are added.
    pub motions: Vec<IsometryMatrix3<f64>>,
}

/// The linear problem at a fit: residuals ≈ `residuals` − `columns`·x, with the priors as further rows.
pub struct Linear {
    /// 3·N + 3·M, weighted: the positions of all observations, then the rotations of the poses among them.
    pub residuals: DVector<f64>,
    /// First rotation row of each observation that is a pose.
    pub rotation_rows: Vec<Option<usize>>,
    /// (3·N + 3·M) × m: links, base and targets in units of their scales; then the terms in units of their priors; then six columns for
    /// each set-up except the reference.
    pub columns: DMatrix<f64>,
    /// The diagonal of Λ, m: Σ (x/S)² = (x − pulled)ᵀ·Λ·(x − pulled) up to a constant.
    pub prior: DVector<f64>,
    /// Λ·pulled, m.
    pub prior_gradient: DVector<f64>,
}

impl<'a> Setting<'a> {
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

    /// Prior standard deviation of each term.
    pub fn widths(&self, terms: &[Term]) -> Vec<f64> {
        let reach_mm = reach_mm(&self.nominal.links);
        let of_terms = terms
            .iter()
            .map(|term| term.prior(&self.mounting, reach_mm));
        of_terms.collect()
    }

    /// The points in their placement at a fit.
    pub fn placed(&self, at: &Fitted) -> Cow<'a, [Observation]> {
        if self.set_ups.is_empty() {
            return Cow::Borrowed(self.observations);
        }
        let all = self.observations.iter().zip(self.set_ups);
        let placed = all.map(|(o, set_up)| match set_up {
            Some(set_up) => o.moved(&at.motions[*set_up]),
            None => o.clone(),
        });
        Cow::Owned(placed.collect())
    }

    /// The linear problem at a fit. Every parameter is free. The links' priors determine what the points do not, so that base and targets
    /// absorb as much as possible.
    pub fn linear(&self, at: &Fitted) -> Linear {
        let corrections = self.corrections(at);
        let unknowns = (self.parameters, at.terms.as_slice());
        let observations = self.placed(at);
        let (residuals, mut by_parameter, mut by_term) = linearise(
            &at.model,
            &corrections,
            &self.mounting,
            unknowns,
            &observations,
        );
        let (p, k) = (self.parameters.len(), at.terms.len());
        let m = p + k + 6 * at.motions.len();
        for (j, scale) in self.scale.iter().enumerate() {
            by_parameter.column_mut(j).scale_mut(*scale);
        }
        let (mut prior, mut prior_gradient) =
            (DVector::<f64>::repeat(m, FLAT), DVector::<f64>::zeros(m));
        prior.rows_mut(p, k).fill(1.0);
        for known in self.priors {
            let j = known.parameter;
            let deviation = deviation_from(self.nominal, &at.model, &self.parameters[j]);
            let scale = self.scale[j] / known.std;
            prior[j] += scale * scale;
            prior_gradient[j] += scale * (known.mean - deviation) / known.std;
        }
        let widths = self.widths(&at.terms);
        for (j, (value, width)) in at.values.iter().zip(widths).enumerate() {
            by_term.column_mut(j).scale_mut(width);
            prior_gradient[p + j] = -value / width;
        }
        let mut columns = DMatrix::zeros(residuals.len(), m);
        columns.columns_mut(0, p).copy_from(&by_parameter);
        columns.columns_mut(p, k).copy_from(&by_term);
        let mut linear = Linear {
            rotation_rows: rotation_rows(&at.model, &observations),
            residuals,
            columns,
            prior,
            prior_gradient,
        };
        if !at.motions.is_empty() {
            let base = base_parameters();
            let unknowns = (base.as_slice(), &[][..]);
            let (_, by_base, _) = linearise(
                &at.model,
                &corrections,
                &self.mounting,
                unknowns,
                &observations,
            );
            self.fill_motions(&mut linear, &by_base, p + k);
        }
        linear
    }

    /// Sum of squares of the residuals at a fit, weighted, as in [`Linear::residuals`].
    fn sum_of_squares(&self, at: &Fitted) -> f64 {
        let corrections = self.corrections(at);
        let observations = self.placed(at);
        let unknowns = (&[][..], &[][..]);
        linearise(
            &at.model,
            &corrections,
            &self.mounting,
            unknowns,
            &observations,
        )
        .0
        .norm_squared()
    }

    /// Σ (x/S)²: parameters with a prior, and corrections.
    fn prior_cost(&self, at: &Fitted) -> f64 {
        let of_parameters = self.priors.iter().map(|known| {
            let parameter = &self.parameters[known.parameter];
            let deviation = deviation_from(self.nominal, &at.model, parameter);
            let off = (deviation - known.mean) / known.std;
            off * off
        });
        let of_terms = at.values.iter().zip(self.widths(&at.terms));
        let of_terms = of_terms.map(|(value, width)| value / width);
        of_parameters.sum::<f64>() + of_terms.map(|x| x * x).sum::<f64>()
    }

    /// The fit after a share of a step, with the same σ².
    fn stepped(&self, at: &Fitted, x: &DVector<f64>, share: f64) -> Fitted {
        let x = x * share;
        let p = self.parameters.len();
        let deviations: Vec<f64> = self.scale.iter().zip(&x).map(|(s, x)| s * x).collect();
        let values = at.values.iter().zip(self.widths(&at.terms)).enumerate();
        Fitted {
            model: apply(&at.model, self.parameters, &deviations),
            values: values
                .map(|(j, (value, width))| value + x[p + j] * width)
                .collect(),
            motions: self.moved(
                &at.motions,
                &x.as_slice()[p + at.terms.len()..],
                &at.model.t_instrument_base,
            ),
            ..at.clone()
        }
    }

    /// Fills the columns of the set-ups: in the rows of a set-up's points, they equal those of the base.
    fn fill_motions(&self, linear: &mut Linear, by_base: &DMatrix<f64>, first: usize) {
        let scale = self.motion_scale();
        for (point, set_up) in self.set_ups.iter().enumerate() {
            let Some(set_up) = set_up else { continue };
            let rows: Vec<usize> = linear.rows_of(point).collect();
            for (row, axis) in rows
                .into_iter()
                .flat_map(|row| (0..6).map(move |a| (row, a)))
            {
                linear.columns[(row, first + 6 * set_up + axis)] =
                    by_base[(row, axis)] * scale[axis];
            }
        }
    }

    /// Units of the six numbers of a set-up: a thousandth of the reach, and a thousandth of a radian.
    fn motion_scale(&self) -> [f64; 6] {
        let mm = MOTION_SCALE * reach_mm(&self.nominal.links);
        [mm, mm, mm, MOTION_SCALE, MOTION_SCALE, MOTION_SCALE]
    }

    /// Moves the set-ups by a step of the solution. `base` is the base for which the columns were computed; the rotations are about its
    /// origin.
    fn moved(
        &self,
        motions: &[IsometryMatrix3<f64>],
        step: &[f64],
        base: &IsometryMatrix3<f64>,
    ) -> Vec<IsometryMatrix3<f64>> {
        let scale = self.motion_scale();
        let origin = base.translation.vector;
        let of_set_up = motions.iter().zip(step.chunks(6));
        of_set_up
            .map(|(before, step)| {
                let number = |axis: usize| step[axis] * scale[axis];
                let shift = Vector3::from_fn(|axis, _| number(axis));
                let turn = rotation_exp(&Vector3::from_fn(|axis, _| number(3 + axis)));
                let moved = Translation3::from(origin + shift - turn * origin);
                // The step moves the prediction; its inverse moves the measured points.
                IsometryMatrix3::from_parts(moved, turn).inverse() * before
            })
            .collect()
    }
}

/// The six numbers of a base.
fn base_parameters() -> Vec<Parameter> {
    let shifts = (0..3).map(Parameter::BaseTranslation);
    shifts.chain((0..3).map(Parameter::BaseRotation)).collect()
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
        let x = cholesky.solve(&(right + &self.prior_gradient * variance));
        x.iter().all(|v| v.is_finite()).then_some((x, cholesky))
    }
}

/// Fits links and `terms`, starting at `start`. Terms that `start` already contains start at their values there.
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
    for step in 1..=STEPS {
        let linear = setting.linear(&at);
        let normal = linear.columns.tr_mul(&linear.columns);
        let right = linear.columns.tr_mul(&linear.residuals);
        let (x, cholesky) = linear.solved(normal, right, at.variance)?;
        let objective = |at: &Fitted, left: f64| left + at.variance * setting.prior_cost(at);
        let mut left = linear.residuals.norm_squared();
        let before = objective(&at, left);
        let mut after = before;
        let shares = std::iter::successors(Some(1.0), |share| Some(0.5 * share));
        for share in shares.take(1 + HALVINGS) {
            let next = setting.stepped(&at, &x, share);
            let left_by_next = setting.sum_of_squares(&next);
            let of_next = objective(&next, left_by_next);
            if of_next <= before {
                (at, left, after) = (next, left_by_next, of_next);
                break;
            }
        }
        // Degrees of freedom that the fit uses: trace((AᵀA + σ²Λ)⁻¹·AᵀA)
        let used = x.len() as f64 - at.variance * cholesky.inverse().diagonal().dot(&linear.prior);
        at.variance = left / (linear.residuals.len() as f64 - used).max(1.0);
        if step >= MIN_STEPS && before - after < CONVERGED * before {
            break;
        }
    }
    at.variance.is_finite().then_some(at)
}
