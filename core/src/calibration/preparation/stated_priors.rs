//! Priors and bounds of a request: checks, conversion for the fit, and outcome.

use crate::calibration::Error;
use crate::calibration::preparation::observe::{free_parameters, model_parameters, placed};
use crate::calibration::problem::Problem;
use crate::calibration::problem::StatedPriors;
use crate::calibration::problem::value_of;
use crate::calibration::report::{PriorOutcome, Warning};
use crate::calibration::request::{CalibrationRequest, ParameterPrior};
use crate::calibration::unusable;
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::estimate;
use crate::identification::least_squares::multistart::best_start;
use crate::identification::model::objective::{cost, with_stations_moved};
use crate::identification::model::parameters::Parameter;
use crate::identification::model::priors::{Prior, Priors};
use crate::identification::statistics::distributions::f_tail;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::solvers::least_squares::Iteration;
use crate::solvers::watch::Watch;

/// Significance level. The points contradict the priors if a loss of fit as large as the observed one has a smaller probability by chance.
const SIGNIFICANCE_LEVEL: f64 = 1e-4;

/// A fault of a prior.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PriorFault {
    /// Index in the request's list.
    pub index: usize,
    /// The field: `name`, `min`, `max` or `mean`.
    pub field: &'static str,
    /// Machine-readable code.
    pub code: &'static str,
    /// What is wrong, and how to correct it.
    pub detail: String,
}

/// All faults of the request's priors, except numbers that are invalid by themselves.
pub fn prior_faults(request: &CalibrationRequest) -> Vec<PriorFault> {
    if request.priors.is_empty() {
        return vec![];
    }
    let n_targets = request.set.n_targets();
    let model = model_parameters(request, n_targets);
    let free = free_parameters(request, n_targets).unwrap_or_default();
    let mut faults = Vec::new();
    for (index, prior) in request.priors.iter().enumerate() {
        let mut fault = |field, code, detail: String| {
            faults.push(PriorFault {
                index,
                field,
                code,
                detail,
            })
        };
        let Some(parameter) = model.iter().find(|p| p.name() == prior.name) else {
            let known: Vec<String> = model
                .iter()
                .filter(|p| may_be_known(p))
                .map(Parameter::name)
                .collect();
            fault(
                "name",
                "unknown_parameter",
                format!(
                    "{:?} is not in this model; it has {}",
                    prior.name,
                    known.join(", ")
                ),
            );
            continue;
        };
        if !may_be_known(parameter) {
            let detail = "the base's turn is counted from its first estimate and cannot be known before: leave its prior out";
            fault("name", "not_applicable", detail.into());
        } else if !free.contains(parameter) {
            fault(
                "name",
                "parameter_held",
                format!(
                    "{} is held at nominal: leave its prior out, or let it free",
                    prior.name
                ),
            );
        }
        if request.priors[..index]
            .iter()
            .any(|other| other.name == prior.name)
        {
            fault(
                "name",
                "duplicate",
                format!("{} has a prior already", prior.name),
            );
        }
        for (field, bound, is_outside) in [
            (
                "min",
                prior.min,
                (|at: f64, bound: f64| at < bound) as fn(f64, f64) -> bool,
            ),
            ("max", prior.max, |at: f64, bound: f64| at > bound),
        ] {
            let centre = prior.mean.map(|mean| (mean, "mean"));
            let nominal = parameter
                .is_link()
                .then(|| (nominal_of(request, parameter), "nominal value"));
            for (at, what) in [centre, nominal].into_iter().flatten() {
                if let Some(bound) = bound.filter(|bound| is_outside(at, *bound)) {
                    let detail = format!(
                        "{bound} leaves out the {what} of {}, {at}: widen the bounds",
                        prior.name
                    );
                    fault(field, "out_of_bounds", detail);
                }
            }
        }
    }
    faults
}

fn may_be_known(parameter: &Parameter) -> bool {
    !matches!(
        parameter,
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..)
    )
}

/// Nominal value of a link's parameter, mm or degrees.
fn nominal_of(request: &CalibrationRequest, parameter: &Parameter) -> f64 {
    let nominal = KinematicModel::nominal(&request.robot.links, request.set.n_targets());
    parameter.in_unit(value_of(&nominal, parameter))
}

fn from_unit(parameter: &Parameter, value: f64) -> f64 {
    if parameter.is_angle() {
        value.to_radians()
    } else {
        value
    }
}

/// The request's priors in the form that the fit uses.
///
/// # Errors
/// The first of [`prior_faults`], [`Error::Cancelled`] when the watch stops.
pub fn stated_priors(
    problem: &Problem<'_>,
    watch: &Watch<'_>,
) -> Result<Option<StatedPriors>, Error> {
    let request = problem.request;
    if request.priors.is_empty() {
        return Ok(None);
    }
    if let Some(fault) = prior_faults(request).into_iter().next() {
        return Err(unusable(
            fault.code,
            format!(
                "prior of {:?}: {}",
                request.priors[fault.index].name, fault.detail
            ),
        ));
    }
    let one = |known: &ParameterPrior| {
        let index = problem
            .parameters
            .iter()
            .position(|p| p.name() == known.name)?;
        let parameter = &problem.parameters[index];
        // Values as in the report: d of the last link excludes the tool that was merged into it.
        let nominal = problem.reported(&problem.nominal, parameter);
        let from_nominal = |value: f64| from_unit(parameter, value) - nominal;
        Some(Prior {
            parameter: index,
            mean: known.mean.map_or(0.0, from_nominal),
            std: from_unit(parameter, known.std),
            min: known.min.map_or(f64::NEG_INFINITY, from_nominal),
            max: known.max.map_or(f64::INFINITY, from_nominal),
        })
    };
    let all: Vec<Prior> = request.priors.iter().filter_map(one).collect();
    let mut priors = Priors::new(&problem.nominal, &problem.parameters, all);
    let (parameters, trusted) = (&problem.parameters, problem.trusted());
    let start = best_start(
        &problem.nominal,
        None,
        parameters,
        &trusted,
        request.stated_position_std_mm(),
        &|links, points| placed(request, links, points, problem.screening.targets.len()),
    )
    .model;
    let mut rows = problem.rows(&trusted, &[]);
    let mut go_on = |_: Iteration| watch.flow();
    let alone = estimate(&rows, &rows.coordinates(&start), 0.0, &mut go_on);
    for prior in &priors.all {
        rows.state(prior.parameter, prior.mean, prior.std);
    }
    let with = estimate(&rows, &alone.x, 0.0, &mut go_on);
    if watch.was_stopped() {
        return Err(Error::Cancelled);
    }
    priors.scale_mm = with.evidence.sigma_mm;
    Ok(Some(StatedPriors {
        priors,
        alone_cost_mm2: cost(
            &alone.model,
            &with_stations_moved(&trusted, &alone.station_motions),
        ),
        alone: alone.model,
    }))
}

/// Outcome of a parameter's prior.
pub fn outcome_of(
    problem: &Problem<'_>,
    model: &KinematicModel,
    index: usize,
    uncertainty: Option<&Uncertainty>,
) -> Option<PriorOutcome> {
    let known = problem.priors.as_ref()?;
    let prior = known
        .priors
        .all
        .iter()
        .find(|prior| prior.parameter == index)?;
    let parameter = &problem.parameters[index];
    let nominal = problem.reported(&problem.nominal, parameter);
    let bound = |bound: f64| {
        bound
            .is_finite()
            .then(|| parameter.in_unit(nominal + bound))
    };
    let at_bound = known
        .priors
        .at_bounds(model)
        .into_iter()
        .find(|(j, _)| *j == index)
        .map(|(_, upper)| if upper { "max" } else { "min" });
    let share = |u: &Uncertainty| {
        let ratio = u.std(index) / prior.std;
        (ratio * ratio).min(1.0)
    };
    Some(PriorOutcome {
        mean: parameter.in_unit(nominal + prior.mean),
        std: parameter.in_unit(prior.std),
        min: bound(prior.min),
        max: bound(prior.max),
        share: uncertainty.filter(|_| at_bound.is_none()).map(share),
        at_bound: at_bound.map(Into::into),
    })
}

/// Warns if the points fit much better without the priors than chance allows, and about parameters that ended at a bound.
pub fn warnings(problem: &Problem<'_>, model: &KinematicModel) -> Vec<Warning> {
    let Some(known) = &problem.priors else {
        return vec![];
    };
    let name = |j: usize| problem.parameters[j].name();
    let mut warnings = Vec::new();
    let at_bounds: Vec<String> = known
        .priors
        .at_bounds(model)
        .into_iter()
        .map(|(j, upper)| format!("{} at its {}", name(j), if upper { "max" } else { "min" }))
        .collect();
    if !at_bounds.is_empty() {
        let detail = format!(
            "{}: no uncertainty is stated where a bound ended the fit, and the others are those beside it",
            at_bounds.join(", ")
        );
        warnings.push(Warning::new("at_bound", detail));
    }
    let trusted = problem.trusted();
    let with_weight = trusted.iter().filter(|o| o.weight > 0.0).count();
    let rows = trusted.iter().filter(|o| o.weight > 0.0);
    let n_rows: usize = rows.map(|o| o.n_rows(model)).sum();
    let n_unknowns = problem.decomposition.rank() + problem.n_station_variables();
    let freedom = n_rows as f64 - n_unknowns as f64;
    let (with, without) = (cost(model, &trusted), known.alone_cost_mm2);
    if freedom < 1.0 {
        return warnings;
    }
    let n = known.priors.all.len() as f64;
    let visible_mm = problem.decomposition.visible_mm;
    let variance = (without / freedom).max(visible_mm * visible_mm);
    if f_tail((with - without).max(0.0) / n / variance, n, freedom) < SIGNIFICANCE_LEVEL {
        let says = |prior: &Prior| {
            let parameter = &problem.parameters[prior.parameter];
            let unit = if parameter.is_angle() { "°" } else { " mm" };
            let of_points = parameter.in_unit(problem.reported(&known.alone, parameter));
            let expected = problem.reported(&problem.nominal, parameter) + prior.mean;
            let expected = parameter.in_unit(expected);
            format!(
                "{} is expected at {expected:.4} ± {:.4}{unit}, the points alone have it at {of_points:.4}",
                name(prior.parameter),
                parameter.in_unit(prior.std)
            )
        };
        let all: Vec<String> = known.priors.all.iter().map(says).collect();
        let rms = |cost: f64| (cost / with_weight as f64).sqrt();
        let detail = format!(
            "the points contradict the priors: with them they fit to {:.4} mm rms, without to {:.4} mm: {}",
            rms(with),
            rms(without),
            all.join("; ")
        );
        warnings.push(Warning::new("prior_contradicted", detail));
    }
    warnings
}
