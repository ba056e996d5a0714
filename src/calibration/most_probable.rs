//! The complete model is fitted by maximum a posteriori: what least squares is to a request, and what its points determine beside the priors.

use crate::calibration::identify::Problem;
use crate::calibration::request::{Model, Preset};
use crate::calibration::robust::{LeastSquares, robust_fit};
use crate::identification::estimate::{estimate, evidence_at, most_probable, prior_cost_mm2};
use crate::identification::fit::SeenFit;
use crate::identification::objective::Observation;
use crate::identification::parameters::deviation_from;
use crate::identification::priors::{Prior, Priors};
use crate::identification::{KinematicModel, problem};
use crate::measurement::Frame;
use crate::solvers::least_squares::Iteration;
use std::ops::ControlFlow;

/// A parameter counts as identifiable from this share of its prior variance on that the points take away.
const DETERMINED: f64 = 0.5;
/// Width of a parameter that is held at a bound, in units of its own: as good as none, and far above rounding.
const HELD: f64 = 1e-6;

/// What points determine beside the priors that parameters have by themselves.
pub struct Determined {
    /// The priors, as wide as the points show them to be, beside the noise of the points.
    pub priors: Priors,
    /// Of each parameter: 1 − posterior variance / prior variance.
    pub data_share: Vec<f64>,
}

fn go_on(_: Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

impl Problem<'_> {
    /// The complete model in the default preset is fitted by maximum a posteriori. In the paper's model, and with its preset, least squares has
    /// no priors but those that the request states.
    pub fn has_own_priors(&self) -> bool {
        self.request.model() == Model::Complete && self.request.preset == Preset::Default
    }

    /// An answer of least squares without priors is drawn towards nominal at the end.
    pub fn is_settled(&self) -> bool {
        self.request.preset == Preset::Default && self.settings.refine && !self.has_own_priors()
    }

    /// Least squares of the points to identify from `start` on.
    pub fn fit(
        &self,
        start: &KinematicModel,
        stop_at_mm2: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        if self.has_own_priors() {
            return self.fit_within_bounds(start, stop_at_mm2, monitor);
        }
        self.fitting()
            .run(start, &self.identify, stop_at_mm2, monitor)
    }

    /// The same with the request's loss. Noise and widths are those of the points that belong together: wild ones would tell of neither.
    pub fn robust_fit(
        &self,
        start: &KinematicModel,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        let (points, trusted) = (&self.identify, self.trusted());
        if !self.has_own_priors() {
            let fitting = self.fitting();
            let of_points = LeastSquares {
                fit: &|start, points| fitting.run(start, points, 0.0, &mut go_on),
                prior_cost_mm2: &|model| fitting.prior_cost_mm2(model),
            };
            return robust_fit(start, &of_points, points, &trusted, self.loss, monitor);
        }
        let rows = self.rows(&trusted, &[]);
        let start = rows.coordinates(start);
        let alone = estimate(&rows, &start, 0.0, &mut go_on);
        let of_points = LeastSquares {
            fit: &|start, points| most_probable(&self.rows(points, &[]), start, &alone.evidence),
            prior_cost_mm2: &|model| prior_cost_mm2(&rows, model, &alone.evidence),
        };
        let (start, loss) = (&alone.model, self.loss);
        robust_fit(start, &of_points, points, &trusted, loss, monitor)
    }

    /// The estimate; where it leaves a bound that the request states, it goes as far as the bounds allow, the parameter whose bound ended
    /// the step is held there, and the others are estimated again. A parameter that would come back inside by itself is let go.
    fn fit_within_bounds(
        &self,
        start: &KinematicModel,
        stop_at_mm2: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> SeenFit {
        let mut fit_with = |held: &[usize], start: &KinematicModel| {
            let rows = self.rows(&self.identify, &self.at(held, start));
            estimate(&rows, &rows.coordinates(start), stop_at_mm2, monitor).into_fit()
        };
        let Some(known) = self.priors.as_ref().map(|known| &known.priors) else {
            return fit_with(&[], start);
        };
        let mut held = Vec::new();
        let mut inside = known.within_bounds(start);
        let mut fit = loop {
            let fit = fit_with(&held, &inside);
            let (model, ended_by) = known.towards(&inside, &fit.model);
            inside = model;
            match ended_by {
                Some(parameter) if !held.contains(&parameter) => held.push(parameter),
                _ => break fit,
            }
        };
        for parameter in held.clone() {
            let others: Vec<usize> = held.iter().copied().filter(|p| *p != parameter).collect();
            let without = fit_with(&others, &inside);
            if let (model, None) = known.towards(&inside, &without.model) {
                (held, inside, fit) = (others, model, without);
            }
        }
        SeenFit {
            model: inside,
            ..fit
        }
    }

    /// Where some parameters of a model are: deviations from nominal, mm or rad.
    fn at(&self, parameters: &[usize], model: &KinematicModel) -> Vec<(usize, f64)> {
        let deviation = |j: &usize| deviation_from(&self.nominal, model, &self.parameters[*j]);
        parameters.iter().map(|j| (*j, deviation(j))).collect()
    }

    /// Some points, the priors that the parameters have by themselves or by the request, and the deviations of those that are held.
    fn rows<'p>(
        &self,
        observations: &'p [Observation],
        held: &[(usize, f64)],
    ) -> problem::Problem<'p> {
        let mut rows = problem::Problem::new(self.nominal.clone(), &self.parameters, observations);
        if self.request.set.frame == Frame::Base {
            rows = rows.with_known_base();
        }
        let stated = self.priors.iter().flat_map(|known| &known.priors.all);
        stated.for_each(|prior| rows.state(prior.parameter, prior.mean, prior.std));
        for (parameter, deviation) in held {
            rows.state(
                *parameter,
                *deviation,
                HELD * rows.variables[*parameter].width,
            );
        }
        rows
    }

    /// For each parameter: true if the points determine it. Where parameters have priors by themselves, the points say at least as much of it
    /// as its prior does; else it takes part in no combination that they do not see.
    pub fn identifiable(&self, model: &KinematicModel) -> Vec<bool> {
        let points = self.loss.as_squares(model, &self.identify);
        match self.determined(model, &points) {
            Some(determined) => {
                let shares = determined.data_share.iter();
                shares.map(|share| *share >= DETERMINED).collect()
            }
            None => self.decomposition.identifiable(),
        }
    }

    /// What some points determine of each parameter, and the priors beside which they do; `None` where parameters have no priors by themselves.
    pub fn determined(
        &self,
        model: &KinematicModel,
        observations: &[Observation],
    ) -> Option<Determined> {
        if !self.has_own_priors() {
            return None;
        }
        let rows = self.rows(observations, &[]);
        let (evidence, posterior) = evidence_at(&rows, model);
        let stated = self.priors.iter().flat_map(|known| &known.priors.all);
        let mut all: Vec<Prior> = stated.copied().collect();
        for (parameter, variable) in rows.variables.iter().enumerate() {
            let is_stated = all.iter().any(|prior| prior.parameter == parameter);
            if !is_stated {
                all.push(Prior {
                    parameter,
                    mean: 0.0,
                    std: evidence.widths[parameter] * variable.width,
                    min: f64::NEG_INFINITY,
                    max: f64::INFINITY,
                });
            }
        }
        let mut priors = Priors::new(&self.nominal, &self.parameters, all);
        priors.scale_mm = evidence.sigma_mm;
        Some(Determined {
            priors,
            data_share: posterior.data_share,
        })
    }
}
