//! Input of the methods: the points of a request, its free parameters, and prior knowledge.

use crate::calibration::preparation::arrangement::{Arrangement, MIN_OF_SETUP};
use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::preparation::observe::{Observed, placed};
use crate::calibration::preparation::screening::Screening;
use crate::calibration::request::{CalibrationRequest, Model};
use crate::calibration::settings::Settings;
use crate::identification::least_squares::linearisation::decomposition_at;
use crate::identification::least_squares::problem::moving_stations;
use crate::identification::model::identifiability::Decomposition;
use crate::identification::model::objective::{Observation, with_weight};
use crate::identification::model::parameters::{Parameter, quantity_mut};
use crate::identification::model::priors::Priors;
use crate::identification::{KinematicModel, TrainedNetwork};
use crate::measurement::Subset;
use nalgebra::IsometryMatrix3;
use std::collections::BTreeSet;

/// Everything that does not change while methods run on a request.
#[derive(Clone)]
pub struct Problem<'a> {
    /// The request.
    pub request: &'a CalibrationRequest,
    /// Resolved options.
    pub settings: Settings,
    /// All points as they are fitted, with their subsets.
    pub observed: Observed,
    /// Outliers and steps.
    pub screening: Screening,
    /// Segments and set-ups of the points.
    pub arrangement: Arrangement,
    /// Loss of the residuals.
    pub loss: PointLoss,
    /// Observations of the identify subset.
    pub identify: Vec<Observation>,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The nominal robot, with base and targets fitted where they are unknown. It is "before" in the report, and the start of least squares.
    pub nominal: KinematicModel,
    /// What the identify subset determines: decomposition of the Jacobian at the nominal robot, scaled by the usual prior widths.
    pub decomposition: Decomposition,
    /// Priors that the request states.
    pub priors: Option<StatedPriors>,
    /// Lower bound of the estimated noise of a row of weight 1, mm: the rounding of the file or, if rows are weighed by their noise and every fitted
    /// point states it, the stated noise. `None` if there is neither.
    pub least_sigma_mm: Option<f64>,
}

/// The stated priors of a problem, and the fit without them.
#[derive(Clone)]
pub struct StatedPriors {
    /// The priors, weighed.
    pub priors: Priors,
    /// The model fitted to the points alone.
    pub alone: KinematicModel,
    /// F of that model at its points, with its own placement of the stations, mm².
    pub alone_cost_mm2: f64,
}

impl Problem<'_> {
    /// The same problem, decomposed at the nominal robot with the tool of `model`. In the paper's model the reflector's height is part of the last d,
    /// and nominal values do not contain it. The directions that a reflector can determine depend on it.
    pub fn with_tool_of(self, model: &KinematicModel) -> Self {
        match self.request.model() {
            Model::Complete => self,
            Model::Paper => self.decomposed_with_tool_of(model),
        }
    }

    /// As [`Self::with_tool_of`], but recomputes the decomposition for any model. In the complete model the tool is part of the targets.
    pub fn decomposed_with_tool_of(self, model: &KinematicModel) -> Self {
        let mut tooled = self.nominal.clone();
        if let (Model::Paper, Some(last)) = (self.request.model(), tooled.links.last_mut()) {
            last.d_mm = model.links[model.links.len() - 1].d_mm;
        }
        let decomposition = decomposition_at(
            &tooled,
            &self.parameters,
            &self.decomposition.scale,
            &self.identify,
        );
        Self {
            decomposition,
            ..self
        }
    }

    /// F of a model, including the cost of the request's priors, mm².
    pub fn cost(&self, model: &KinematicModel) -> f64 {
        let of_priors = self
            .priors
            .as_ref()
            .map_or(0.0, |known| known.priors.cost_mm2(model));
        self.loss.cost(model, &self.identify) + of_priors
    }

    /// The identify points, with weight 0 for outliers.
    pub fn trusted(&self) -> Vec<Observation> {
        let outliers: BTreeSet<usize> = self.screening.outliers.iter().map(|w| w.row).collect();
        let rows = (0..self.observed.all.len())
            .filter(|row| self.observed.subsets[*row] == Subset::Identify);
        let weight = |o: &Observation, row: usize| {
            if outliers.contains(&row) {
                0.0
            } else {
                o.weight
            }
        };
        self.identify
            .iter()
            .zip(rows)
            .map(|(o, row)| Observation {
                weight: weight(o, row),
                ..o.clone()
            })
            .collect()
    }

    /// The same problem with the points of each station moved, and the nominal robot placed on them. A station without a motion stays.
    pub fn with_stations_moved(mut self, motions: &[IsometryMatrix3<f64>]) -> Self {
        if !motions.is_empty() {
            self.arrangement.move_stations(motions);
            self.arrangement.apply(&mut self.observed);
            self.identify = self.observed.of(Subset::Identify);
            let links = self.nominal.links.clone();
            let n_targets = self.screening.targets.len();
            self.nominal = placed(self.request, links, &with_weight(&self.identify), n_targets);
            if let Some(known) = &mut self.priors {
                known.priors = known.priors.with_reference(&self.nominal);
            }
        }
        self
    }

    /// Number of variables of the stations of the identify points.
    pub fn n_station_variables(&self) -> usize {
        6 * moving_stations(&self.identify, MIN_OF_SETUP).len()
    }

    /// The network that the job may start from.
    pub fn network(&self) -> Option<&TrainedNetwork> {
        self.request.network.as_ref()
    }

    /// The network's answer as a deviation from nominal for each parameter; 0 for base and targets.
    pub fn answer_deviation(&self) -> Vec<f64> {
        let mut answer = self
            .network()
            .map(|n| n.answer.clone())
            .unwrap_or_default()
            .into_iter();
        self.parameters
            .iter()
            .map(|p| {
                if p.is_link() {
                    answer.next().unwrap_or(0.0)
                } else {
                    0.0
                }
            })
            .collect()
    }
}

/// A parameter's value in a model, mm or rad; 0 for rotations of base and targets.
pub fn value_of(model: &KinematicModel, parameter: &Parameter) -> f64 {
    match *parameter {
        Parameter::Link(link, quantity) => *quantity_mut(&mut model.links[link].clone(), quantity),
        Parameter::BaseTranslation(axis) => model.t_instrument_base.translation.vector[axis],
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => 0.0,
        Parameter::Target(target, axis) => model.targets_mm[target][axis],
    }
}
