//! Least squares with priors and bounds: an active set around Levenberg-Marquardt.
//!
//! Along the combinations that the points see or the priors say something of, least squares takes the priors as rows. Where its answer
//! leaves a bound, the fit goes as far as the bounds allow, holds the parameter whose bound ended the step, and goes on; one that is held is
//! let go where F falls towards the inside (Nocedal & Wright, Numerical Optimization, 2006, section 16.5, on linearised F).

use crate::identification::KinematicModel;
use crate::identification::fit::{SeenFit, fit_along_seen, fit_in_rounds};
use crate::identification::identifiability::VISIBLE_EFFECT_MM;
use crate::identification::objective::{Observation, cost, weighted_jacobian, weighted_residuals};
use crate::identification::parameters::Parameter;
use crate::identification::priors::{Known, Priors};
use crate::identification::search_space::{SearchSpace, decomposition_at};
use crate::solvers::least_squares::{Iteration, Termination};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::ops::ControlFlow;

/// Changes of the active set for each bounded parameter, at most.
const CHANGES_PER_BOUND: usize = 4;
/// A parameter is let go where the cosine between the residuals and its column is above this.
const LETS_GO: f64 = 1e-9;
/// Fits that σ is found from, at most.
const SCALE_FITS: usize = 50;
/// Relative change of σ that ends them.
const SCALE_FOUND: f64 = 1e-9;

/// What is fitted: parameters with their scales, and what is known of them.
#[derive(Clone, Copy, Debug)]
pub struct Fitting<'a> {
    /// The free parameters.
    pub parameters: &'a [Parameter],
    /// Their scales, mm or rad.
    pub scale: &'a [f64],
    /// What is known of them; `None` for nothing.
    pub priors: Option<&'a Priors>,
}

impl Fitting<'_> {
    /// Least squares from `start`.
    pub fn run(
        &self,
        start: &KinematicModel,
        observations: &[Observation],
        stop_at_cost: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        match self.priors {
            None => fit_along_seen(
                start,
                self.parameters,
                self.scale,
                observations,
                stop_at_cost,
                monitor,
            ),
            Some(priors) => {
                self.with_active_set(priors, start, observations, stop_at_cost, monitor)
            }
        }
    }

    /// What the priors add to F of a model, mm².
    pub fn prior_cost_mm2(&self, model: &KinematicModel) -> f64 {
        self.priors.map_or(0.0, |priors| priors.cost_mm2(model))
    }

    fn with_active_set(
        &self,
        priors: &Priors,
        start: &KinematicModel,
        observations: &[Observation],
        stop_at_cost: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        let start = priors.within_bounds(start);
        let cost_of = |model: &KinematicModel| cost(model, observations) + priors.cost_mm2(model);
        let mut held: BTreeMap<usize, bool> = BTreeMap::new();
        let mut let_go: Vec<usize> = Vec::new();
        let (convergence, termination) = (vec![cost_of(&start)], Termination::IterationLimit);
        let mut found = SeenFit {
            model: start,
            n_iterations: 0,
            n_evaluations: 1,
            convergence,
            termination,
        };
        for _ in 0..=CHANGES_PER_BOUND * priors.all.len() {
            let fit = self.free_fit(priors, &held, &found, observations, stop_at_cost, monitor);
            let (model, ended_by) = priors.towards(&found.model, &fit.model);
            record(&mut found, &fit, ended_by.map(|_| cost_of(&model)));
            found.model = model;
            if fit.termination == Termination::Stopped {
                break;
            }
            let at_bounds = priors.at_bounds(&found.model);
            if let Some(parameter) = ended_by {
                let upper = at_bounds
                    .iter()
                    .any(|(at, upper)| *at == parameter && *upper);
                held.insert(parameter, upper);
                found.termination = Termination::IterationLimit;
                continue;
            }
            // one that was let go and came back stays
            let candidates: Vec<(usize, bool)> = held
                .iter()
                .map(|(j, upper)| (*j, *upper))
                .filter(|(j, _)| !let_go.contains(j))
                .collect();
            let Some(parameter) =
                self.wants_inside(priors, &candidates, &found.model, observations)
            else {
                break;
            };
            held.remove(&parameter);
            let_go.push(parameter);
        }
        found
    }

    /// Least squares with the held parameters where they are, bounds not looked at.
    fn free_fit(
        &self,
        priors: &Priors,
        held: &BTreeMap<usize, bool>,
        from: &SeenFit,
        observations: &[Observation],
        stop_at_cost: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        let scale: Vec<f64> = self
            .scale
            .iter()
            .enumerate()
            .map(|(j, s)| if held.contains_key(&j) { 0.0 } else { *s })
            .collect();
        let stds: Vec<(usize, f64)> = priors
            .stds()
            .into_iter()
            .filter(|(j, _)| !held.contains_key(j))
            .collect();
        let around = |model: &KinematicModel| {
            let (directions, _) = decomposition_at(model, self.parameters, &scale, observations)
                .directions_with_priors(&stds);
            let known = Known {
                pulls: priors.from(model).pulls,
                limits: vec![],
            };
            SearchSpace::along(
                model.clone(),
                self.parameters.to_vec(),
                scale.clone(),
                directions,
            )
            .knowing(known)
        };
        let done = from.n_iterations;
        let mut watch = |i: Iteration| {
            monitor(Iteration {
                iteration: done + i.iteration,
                max_iterations: done + i.max_iterations,
                ..i
            })
        };
        fit_in_rounds(&from.model, around, observations, stop_at_cost, &mut watch)
    }

    /// Of the held parameters, the one that F most wants back inside its bounds.
    fn wants_inside(
        &self,
        priors: &Priors,
        held: &[(usize, bool)],
        model: &KinematicModel,
        observations: &[Observation],
    ) -> Option<usize> {
        let jacobian = weighted_jacobian(model, self.parameters, observations, &Vector3::zeros());
        let residuals = weighted_residuals(model, observations);
        let pulls = priors.from(model).pulls;
        let none = vec![0.0; self.parameters.len()];
        let known = Known {
            pulls,
            limits: vec![],
        };
        let length = (residuals.norm_squared() + known.cost_mm2(&none)).sqrt();
        let cosine = |(j, upper): &(usize, bool)| {
            let of_prior = known
                .pulls
                .iter()
                .zip(known.residuals(&none))
                .find(|(pull, _)| pull.parameter == *j);
            let (along, square) = of_prior.map_or((0.0, 0.0), |(pull, r)| {
                (pull.weight * r, pull.weight * pull.weight)
            });
            let column = jacobian.column(*j);
            // F falls as the parameter grows where this is positive
            let falls = column.dot(&residuals) + along;
            let inside = if *upper { -falls } else { falls };
            (
                inside / ((column.norm_squared() + square).sqrt() * length).max(f64::MIN_POSITIVE),
                *j,
            )
        };
        let best = held.iter().map(cosine).max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > LETS_GO).then_some(best.1)
    }
}

/// Adds a fit to the record. Its points may lie outside the bounds: unless it stayed inside, F of what is allowed counts at its end only.
fn record(found: &mut SeenFit, fit: &SeenFit, ended_at_cost: Option<f64>) {
    let mut least = found.convergence.last().copied().unwrap_or(f64::INFINITY);
    for (step, cost) in fit.convergence.iter().enumerate().skip(1) {
        let allowed = match ended_at_cost {
            None => *cost,
            Some(cost) if step == fit.n_iterations => cost,
            Some(_) => least,
        };
        least = least.min(allowed);
        found.convergence.push(least);
    }
    found.n_iterations += fit.n_iterations;
    found.n_evaluations += fit.n_evaluations;
    found.termination = fit.termination;
}

/// What the points say without the priors, and σ with which the priors count beside them.
///
/// σ is what the points scatter by about the answer that it leads to. It is looked for from above, from the fit with every such parameter
/// where it is expected: of several that fit together the largest is taken, so that a prior is believed unless no noise explains the points
/// beside it. At least [`VISIBLE_EFFECT_MM`], which no instrument resolves.
pub fn weighed(
    mut priors: Priors,
    start: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
    observations: &[Observation],
) -> (Priors, SeenFit) {
    let go_on = &mut |_: Iteration| ControlFlow::Continue(());
    let alone = fit_along_seen(start, parameters, scale, observations, 0.0, go_on);
    let counting = observations.iter().filter(|o| o.weight > 0.0).count();
    let rank = decomposition_at(&alone.model, parameters, scale, observations).rank();
    let freedom = (3.0 * counting as f64 - rank as f64).max(1.0);
    let scatter = |model: &KinematicModel| {
        (cost(model, observations) / freedom)
            .sqrt()
            .max(VISIBLE_EFFECT_MM)
    };
    let stds = priors.stds();
    let others: Vec<f64> = scale
        .iter()
        .enumerate()
        .map(|(j, s)| {
            if stds.iter().any(|(k, _)| *k == j) {
                0.0
            } else {
                *s
            }
        })
        .collect();
    let expected = priors.within_bounds(&priors.at_means(&alone.model));
    let mut model = fit_along_seen(&expected, parameters, &others, observations, 0.0, go_on).model;
    priors.scale_mm = scatter(&model);
    for _ in 0..SCALE_FITS {
        model = Fitting {
            parameters,
            scale,
            priors: Some(&priors),
        }
        .run(&model, observations, 0.0, go_on)
        .model;
        let next = scatter(&model).min(priors.scale_mm);
        let is_found = priors.scale_mm - next <= SCALE_FOUND * next;
        priors.scale_mm = next;
        if is_found {
            break;
        }
    }
    (priors, alone)
}
