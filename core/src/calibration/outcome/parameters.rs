//! The parameters of a report: values, uncertainties, and how far the points determine them.

use crate::calibration::preparation::stated_priors;
use crate::calibration::problem::Problem;
use crate::calibration::problem::value_of;
use crate::calibration::report::{Identifiability, ParameterOutcome};
use crate::calibration::request::Model;
use crate::calibration::solve::most_probable::DETERMINED;
use crate::identification::KinematicModel;
use crate::identification::model::parameters::{Parameter, Quantity, deviation_from};
use crate::identification::statistics::uncertainty::Uncertainty;

/// Coverage probability of a parameter's stated interval.
const CONFIDENCE: f64 = 0.95;

/// Nominal and identified value of each free parameter, in mm and degrees.
pub fn parameters(
    problem: &Problem<'_>,
    model: &KinematicModel,
    uncertainty: Option<&Uncertainty>,
    data_share: &[f64],
) -> Vec<ParameterOutcome> {
    let identifiable: Vec<bool> = data_share
        .iter()
        .map(|share| *share >= DETERMINED)
        .collect();
    let stated = stated(problem, model, &identifiable);
    let outcome = |(i, parameter): (usize, &Parameter)| {
        let (nominal, identified) = (
            problem.reported(&problem.nominal, parameter),
            problem.reported(model, parameter),
        );
        let to_wire = |value: f64| parameter.in_unit(value);
        let known = uncertainty.filter(|_| stated[i]);
        let interval = |u: &Uncertainty| {
            let half_width = u.half_width(i, CONFIDENCE);
            [
                to_wire(identified - half_width),
                to_wire(identified + half_width),
            ]
        };
        ParameterOutcome {
            name: problem.screening.targets.name(parameter),
            link: if let Parameter::Link(link, _) = parameter {
                Some(link + 1)
            } else {
                None
            },
            unit: parameter.unit().into(),
            nominal: to_wire(nominal),
            identified: to_wire(identified),
            delta: to_wire(identified - nominal),
            std_uncertainty: known.map(|u| to_wire(u.std(i))),
            interval_95: known.map(interval),
            data_share: Some(data_share[i].clamp(0.0, 1.0)),
            identifiable: identifiable[i],
            prior: stated_priors::outcome_of(problem, model, i, uncertainty),
        }
    };
    problem.parameters.iter().enumerate().map(outcome).collect()
}

/// For each parameter: true if its uncertainty can be stated. The points must determine the parameter or the request must state a prior for it, and
/// the fit must not have ended at a bound.
fn stated(problem: &Problem<'_>, model: &KinematicModel, identifiable: &[bool]) -> Vec<bool> {
    let Some(known) = &problem.priors else {
        return identifiable.to_vec();
    };
    let at_bounds = known.priors.at_bounds(model);
    let has_prior = |j: usize| known.priors.all.iter().any(|prior| prior.parameter == j);
    let is_free = |j: &usize| at_bounds.iter().all(|(k, _)| k != j);
    (0..problem.parameters.len())
        .map(|j| is_free(&j) && (identifiable[j] || has_prior(j)))
        .collect()
}

impl Problem<'_> {
    /// Value of a parameter as reported, mm or rad. Rotations of base and targets are relative to their first estimate. For d of the last
    /// link, the tool length that sweeps merged into it is subtracted.
    pub fn reported(&self, model: &KinematicModel, parameter: &Parameter) -> f64 {
        let last_d = Parameter::Link(model.links.len() - 1, Quantity::D);
        match parameter {
            Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => {
                deviation_from(&self.nominal, model, parameter)
            }
            p if *p == last_d => {
                let frames = self
                    .request
                    .frames
                    .as_ref()
                    .filter(|_| self.request.model() == Model::Paper);
                value_of(model, p) - frames.map_or(0.0, |frames| frames.z_tool_mm)
            }
            p => value_of(model, p),
        }
    }
}

pub fn identifiability(problem: &Problem<'_>) -> Identifiability {
    let names = |group: Vec<usize>| {
        group
            .into_iter()
            .map(|i| problem.screening.targets.name(&problem.parameters[i]))
            .collect()
    };
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    Identifiability {
        n_parameters: problem.parameters.len(),
        rank: problem.decomposition.rank(),
        n_by_priors: problem.priors.as_ref().map(|known| {
            let (with, _) = problem
                .decomposition
                .directions_with_priors(&known.priors.stds());
            with.ncols() - problem.decomposition.rank()
        }),
        condition_number: finite(problem.decomposition.condition_number()),
        unidentifiable: problem
            .decomposition
            .unseen_groups()
            .into_iter()
            .map(names)
            .collect(),
        observability_index_o1: finite(problem.decomposition.observability_index_o1()),
    }
}
