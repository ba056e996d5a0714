//! What methods run on: the points of a request, its free parameters, and what is known of them.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::preparation::screening::Screening;
use crate::calibration::request::{CalibrationRequest, Model};
use crate::calibration::settings::Settings;
use crate::identification::identifiability::Decomposition;
use crate::identification::linearisation::decomposition_at;
use crate::identification::objective::Observation;
use crate::identification::parameters::{Parameter, quantity_mut};
use crate::identification::priors::Priors;
use crate::identification::{KinematicModel, TrainedNetwork};
use crate::measurement::Subset;
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// Everything that does not change while methods run on a request.
pub struct Problem<'a> {
    /// The request.
    pub request: &'a CalibrationRequest,
    /// Resolved options.
    pub settings: Settings,
    /// All points as they are fitted, with their subsets.
    pub observed: Observed,
    /// Which points do not belong, and what moved.
    pub screening: Screening,
    /// Segments and set-ups of the points.
    pub arrangement: Arrangement,
    /// How a residual counts.
    pub loss: PointLoss,
    /// What is fitted.
    pub identify: Vec<Observation>,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The nominal robot, with base and targets fitted where they are unknown: "before", and what least squares starts from.
    pub nominal: KinematicModel,
    /// What the identify subset can see, at the nominal robot, scaled by the stated priors.
    pub decomposition: Decomposition,
    /// What is known of the parameters beforehand.
    pub priors: Option<StatedPriors>,
    /// Least noise of a row of weight 1 that the instrument states, mm; of poses.
    pub least_sigma_mm: Option<f64>,
}

/// The priors of a problem, and what its points say without them.
pub struct StatedPriors {
    /// The priors, weighed.
    pub priors: Priors,
    /// The answer of the points alone.
    pub alone: KinematicModel,
}

impl Problem<'_> {
    /// The same with what the points see taken at the nominal robot with its tool: in the paper's model the reflector's height is part of
    /// the last d, of which nominal values know nothing, and on it depends what a reflector shows.
    pub fn with_tool_of(self, model: &KinematicModel) -> Self {
        match self.request.model() {
            Model::Complete => self,
            Model::Paper => self.decomposed_with_tool_of(model),
        }
    }

    /// The same for any model: the complete one has its tool in the targets.
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

    /// F of a model, that of the request's priors included, mm².
    pub fn cost(&self, model: &KinematicModel) -> f64 {
        let of_priors = self
            .priors
            .as_ref()
            .map_or(0.0, |known| known.priors.cost_mm2(model));
        self.loss.cost(model, &self.identify) + of_priors
    }

    /// The points to identify, those that do not belong without weight.
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

    /// The set-up of the instrument of each point to identify, from 0; `None` for the one whose frame the model stands in.
    pub fn stations_to_identify(&self) -> Vec<Option<usize>> {
        let resting = self.arrangement.resting();
        let number = |setup: usize| match setup.cmp(&resting) {
            Ordering::Less => Some(setup),
            Ordering::Equal => None,
            Ordering::Greater => Some(setup - 1),
        };
        let rows = self.observed.subsets.iter().zip(&self.arrangement.setups);
        rows.filter(|(subset, _)| **subset == Subset::Identify)
            .map(|(_, setup)| number(*setup))
            .collect()
    }

    /// The network that the job may start from.
    pub fn network(&self) -> Option<&TrainedNetwork> {
        self.request.network.as_ref()
    }

    /// Link deviations of the network's answer from nominal, spread over all parameters (base and targets: none).
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

/// A parameter's value in a model, mm or rad.
pub fn value_of(model: &KinematicModel, parameter: &Parameter) -> f64 {
    match *parameter {
        Parameter::Link(link, quantity) => *quantity_mut(&mut model.links[link].clone(), quantity),
        Parameter::BaseTranslation(axis) => model.t_instrument_base.translation.vector[axis],
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => 0.0,
        Parameter::Target(target, axis) => model.targets_mm[target][axis],
    }
}
