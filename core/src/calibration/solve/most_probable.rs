//! Maximum a posteriori estimate of a request's robot, and how much its points determine beyond the priors.

use crate::calibration::preparation::arrangement::MIN_OF_SETUP;
use crate::calibration::preparation::loss::{LeastSquares, robust_fit};
use crate::calibration::problem::Problem;
use crate::calibration::request::{Model, Preset};
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::{
    FitSummary, estimate, evidence_at, most_probable, prior_cost_mm2,
};
use crate::identification::least_squares::evidence::Noise;
use crate::identification::least_squares::problem;
use crate::identification::model::objective::{Observation, composed_motions, with_stations_moved};
use crate::identification::model::parameters::{
    Parameter, Quantity, copy_parameter, deviation_from,
};
use crate::identification::model::priors::{Prior, Priors};
use crate::measurement::Frame;
use crate::solvers::least_squares::Iteration;
use crate::solvers::watch::Watch;
use std::ops::ControlFlow;

/// A parameter is identifiable if the points reduce its prior variance by at least this share.
pub const DETERMINED: f64 = 0.5;
/// Width of a parameter held at a bound, relative to its usual width: practically zero, and far above rounding.
pub const HELD: f64 = 1e-6;

/// A held parameter: its index, and its deviation from nominal, mm or rad.
pub type Held = (usize, f64);

/// What points determine beyond the parameters' own priors.
pub struct Determined {
    /// The priors with the widths that the evidence gives, and the noise of the points.
    pub priors: Priors,
    /// For each parameter: 1 − posterior variance / prior variance.
    pub data_share: Vec<f64>,
}

impl Problem<'_> {
    /// The estimate from the identify points, from a start model.
    pub fn fit(
        &self,
        start: &KinematicModel,
        stop_at_mm2: f64,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> FitSummary {
        self.within_bounds(start, &mut |held, start| {
            let rows = self.rows(&self.identify, held);
            estimate(&rows, &rows.coordinates(start), stop_at_mm2, monitor).into_summary()
        })
    }

    /// The estimate with the request's loss. Noise and prior widths come from the points without outliers, which would distort both.
    /// The result is not valid if the watch stopped.
    pub fn robust_fit(
        &self,
        start: &KinematicModel,
        watch: &Watch<'_>,
        monitor: &mut dyn FnMut(Iteration) -> ControlFlow<()>,
    ) -> FitSummary {
        let trusted = self.trusted();
        let alone = self.within_bounds(start, &mut |held, start| {
            let rows = self.rows(&trusted, held);
            estimate(&rows, &rows.coordinates(start), 0.0, &mut |_| watch.flow()).into_summary()
        });
        let points = with_stations_moved(&self.identify, &alone.station_motions);
        let trusted = with_stations_moved(&trusted, &alone.station_motions);
        let rows = self.rows(&trusted, &[]);
        let (evidence, _) = evidence_at(&rows, &rows.coordinates(&alone.model));
        let of_points = LeastSquares {
            fit: &|start, points| {
                self.within_bounds(start, &mut |held, start| {
                    let mut evidence = evidence.clone();
                    held.iter().for_each(|(j, _)| evidence.widths[*j] = HELD);
                    most_probable(&self.rows(points, held), start, &evidence, watch)
                })
            },
            prior_cost_mm2: &|model| prior_cost_mm2(&rows, model, &evidence),
        };
        let (start, loss) = (&alone.model, self.loss);
        let mut tell = |i: Iteration| match watch.was_stopped() {
            true => ControlFlow::Break(()),
            false => monitor(i),
        };
        let fit = robust_fit(start, &of_points, &points, &trusted, loss, &mut tell);
        FitSummary {
            station_motions: composed_motions(&alone.station_motions, &fit.station_motions),
            ..fit
        }
    }

    /// A fit inside the bounds that the request states. `fit_with` fits with some parameters held (by index, with their deviations from nominal). If
    /// a fit leaves the bounds, the step ends at the first bound, its parameter is held there, and the others are fitted again. A held parameter that
    /// stays inside the bounds when it is freed is released.
    fn within_bounds(
        &self,
        start: &KinematicModel,
        fit_with: &mut dyn FnMut(&[Held], &KinematicModel) -> FitSummary,
    ) -> FitSummary {
        let Some(known) = self.priors.as_ref().map(|known| &known.priors) else {
            return fit_with(&[], start);
        };
        let mut fit_with = |held: &[Held], start: &KinematicModel| {
            let mut fit = fit_with(held, start);
            for (parameter, _) in held {
                copy_parameter(&self.parameters[*parameter], start, &mut fit.model);
            }
            fit
        };
        let mut held: Vec<Held> = Vec::new();
        let mut inside = known.within_bounds(start);
        let mut fit = loop {
            let fit = fit_with(&held, &inside);
            let (model, ended_by) = known.towards(&inside, &fit.model);
            inside = model;
            let Some(parameter) = ended_by else { break fit };
            let at = deviation_from(&self.nominal, &inside, &self.parameters[parameter]);
            held.push((parameter, at));
        };
        for (parameter, _) in held.clone() {
            let mut others = held.clone();
            others.retain(|(j, _)| *j != parameter);
            let without = fit_with(&others, &inside);
            if let (model, None) = known.towards(&inside, &without.model) {
                (held, inside, fit) = (others, model, without);
            }
        }
        FitSummary {
            model: inside,
            ..fit
        }
    }

    /// The problem of some points: base, links, targets and stations, with the parameters' own or stated priors. Held parameters keep their
    /// deviations.
    pub fn rows<'p>(&self, observations: &'p [Observation], held: &[Held]) -> problem::Problem<'p> {
        let mut rows = problem::Problem::new(self.nominal.clone(), &self.parameters, observations)
            .with_stations(observations, MIN_OF_SETUP);
        rows.least_sigma_mm = self.least_sigma_mm.unwrap_or(rows.least_sigma_mm);
        if self.request.set.frame == Frame::Base {
            rows = rows.with_known_base();
        }
        // The paper's least squares has no priors.
        if self.request.preset == Preset::Paper {
            rows.without_own_priors();
        }
        if self.request.model() == Model::Paper {
            rows.free(Parameter::Link(self.nominal.links.len() - 1, Quantity::D));
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

    /// Noise of the identify points about a model of links alone.
    pub fn noise(&self, model: &KinematicModel) -> Noise {
        let points = self.loss.as_squares(model, &self.identify);
        let rows = self.rows(&points, &[]);
        let (evidence, posterior) = evidence_at(&rows, &rows.coordinates(model));
        Noise::of(&rows, &evidence, &posterior)
    }

    /// For each parameter: the share of its prior variance that the identify points remove.
    pub fn data_share(&self, model: &KinematicModel) -> Vec<f64> {
        let points = self.loss.as_squares(model, &self.identify);
        self.determined(model, &points).data_share
    }

    /// What some points determine of each parameter, and the priors that were used.
    pub fn determined(&self, model: &KinematicModel, observations: &[Observation]) -> Determined {
        let rows = self.rows(observations, &[]);
        let (evidence, posterior) = evidence_at(&rows, &rows.coordinates(model));
        let stated = self.priors.iter().flat_map(|known| &known.priors.all);
        let mut all: Vec<Prior> = stated.copied().collect();
        let of_parameters = rows.variables.iter().take(self.parameters.len());
        for (parameter, variable) in of_parameters.enumerate() {
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
        Determined {
            priors,
            data_share: posterior.data_share[..self.parameters.len()].to_vec(),
        }
    }
}
