//! Uncertainty of the answer. If no valid uncertainty can be computed, none is stated, and the report says why.

use crate::calibration::preparation::equations::n_equations;
use crate::calibration::problem::Problem;
use crate::calibration::report::{SubsetErrors, Warning};
use crate::calibration::solve::most_probable::Held;
use crate::identification::KinematicModel;
use crate::identification::least_squares::start::fit_base_and_targets;
use crate::identification::model::objective::{Observation, rms_mm, with_weight};
use crate::identification::model::parameters::{Parameter, complete_parameters, deviation_from};
use crate::identification::statistics::misfit::{Following, HARMONICS, Misfit, gravity_directions};
use crate::identification::statistics::uncertainty::{Session, Uncertainty, uncertainty};
use crate::identification::statistics::workspace::ToolUncertainty;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;
use std::collections::BTreeSet;

/// Largest distance of the answer from the minimum of the cost, in standard deviations. The covariance holds only at the minimum.
const AT_MINIMUM_STDS: f64 = 1.0;

/// Errors of parameters and tool estimated from the residuals, whether or not they can be stated.
pub fn estimated(
    problem: &Problem<'_>,
    model: &KinematicModel,
    watch: &Watch<'_>,
) -> Option<Uncertainty> {
    if without_redundancy(problem).is_some() {
        return None;
    }
    let clusters = problem.observed.clusters(Subset::Identify);
    let with_weight: Vec<usize> = (0..clusters.len())
        .filter(|i| problem.identify[*i].weight > 0.0)
        .collect();
    let points = problem.loss.as_squares(model, &problem.identify);
    let mut known = BTreeSet::new();
    // Exact duplicates of a row count once, because they come from one measurement.
    let bits = |o: &Observation| -> Vec<u64> {
        o.q_rad
            .iter()
            .chain(o.position_mm.iter())
            .chain(o.rotation.iter().flat_map(|r| r.rotation.matrix().iter()))
            .map(|x| x.to_bits())
            .collect()
    };
    let with_weight: Vec<usize> = with_weight
        .into_iter()
        .filter(|i| known.insert((problem.identify[*i].target, bits(&problem.identify[*i]))))
        .collect();
    let observations: Vec<Observation> = with_weight.iter().map(|i| points[*i].clone()).collect();
    let configurations: Vec<usize> = with_weight.iter().map(|i| clusters[*i]).collect();
    let held: Vec<Held> = match &problem.priors {
        Some(known) => {
            let at_bounds = known.priors.at_bounds(model).into_iter();
            let deviation =
                |j: usize| deviation_from(&problem.nominal, model, &problem.parameters[j]);
            at_bounds.map(|(j, _)| (j, deviation(j))).collect()
        }
        None => vec![],
    };
    let rows = problem.rows(&observations, &held);
    uncertainty(Session {
        model,
        problem: &rows,
        observations: &observations,
        configurations: &configurations,
        corrections: None,
        misfit: misfit(problem),
        watch,
    })
}

/// The possible sources of a misfit of the problem's robot.
pub fn misfit(problem: &Problem<'_>) -> Misfit {
    let robot = &problem.request.robot;
    let is_held = |parameter: &Parameter| !problem.parameters.contains(parameter);
    Misfit {
        followings: Following::of_arm(robot.links.len(), &problem.identify),
        gravity: gravity_directions(robot.mounting.as_ref().map(|m| &m.gravity_in_base)),
        harmonics: HARMONICS.to_vec(),
        held: complete_parameters(robot.links.len(), problem.screening.targets.len())
            .into_iter()
            .filter(is_held)
            .collect(),
    }
}

/// Why no uncertainty is stated; `None` if one is stated.
pub fn why_not_stated(problem: &Problem<'_>, estimated: Option<&Uncertainty>) -> Option<String> {
    let Some(estimated) = estimated else {
        let why = match without_redundancy(problem) {
            Some(_) => "no more equations than unknowns: nothing says how good the fit is",
            None => "the equations cannot be solved for it",
        };
        return Some(why.into());
    };
    let stds = estimated.stds_from_minimum;
    if stds > AT_MINIMUM_STDS || stds.is_nan() {
        return Some(format!(
            "the method did not converge: the answer is {stds:.1} standard deviations away from the minimum of the cost, and the uncertainty \
             of that minimum is not that of this answer. Calibrate again with refine, or with method auto"
        ));
    }
    None
}

/// Kept corrections show a misfit of the links alone. The size of this misfit is sqrt(after² − corrected²), from the rms before and after the
/// corrections. The links have this error wherever they are used, so their stated uncertainty is at least as large.
pub fn with_found_misfit(of_links: ToolUncertainty, identify: &SubsetErrors) -> ToolUncertainty {
    let Some(corrected) = identify.corrected else {
        return of_links;
    };
    let (after_mm, corrected_mm) = (identify.after.rms_mm, corrected.rms_mm);
    let misfit_mm = (after_mm * after_mm - corrected_mm * corrected_mm)
        .max(0.0)
        .sqrt();
    ToolUncertainty {
        mean_mm: of_links.mean_mm.max(misfit_mm),
        max_mm: of_links.max_mm.max(misfit_mm),
    }
}

/// Why the tool's uncertainty is useless: the nominal robot, with base and targets fitted to the points, is closer than this uncertainty.
pub fn useless_uncertainty_reason(problem: &Problem<'_>, tool: &ToolUncertainty) -> Option<String> {
    let n_targets = problem.screening.targets.len();
    let points = with_weight(&problem.trusted());
    let links = &problem.request.robot.links;
    let nominal_mm = rms_mm(&fit_base_and_targets(links, &points, n_targets), &points);
    // A NaN fails this comparison, so it counts as useless.
    if tool.mean_mm <= nominal_mm {
        return None;
    }
    Some(format!(
        "these points do not determine the robot over its workspace: by them its tool would be known to {:.3} mm, and the nominal robot is off by {nominal_mm:.3} \
         mm (rms, on these points). Measure poses spread over the workspace, with every joint moving",
        tool.mean_mm
    ))
}

/// As [`estimated`], but `None` if the uncertainty cannot be stated.
pub fn stated(
    problem: &Problem<'_>,
    model: &KinematicModel,
    watch: &Watch<'_>,
) -> Option<Uncertainty> {
    estimated(problem, model, watch).filter(|found| why_not_stated(problem, Some(found)).is_none())
}

/// Warning if there is no redundancy: the fit then follows every error of the points.
pub fn no_redundancy_warning(problem: &Problem<'_>) -> Option<Warning> {
    let (equations, rank) = without_redundancy(problem)?;
    let detail = format!(
        "{equations} equations from distinct configurations to identify from fix {rank} combinations of parameters and places of stations: the fit can \
         follow any error of the points, and what is left of them says nothing of how far the robot is off. Measure more configurations, or hold parameters"
    );
    Some(Warning {
        code: "nothing_left_to_judge",
        detail,
        rows: vec![],
    })
}

/// Number of equations and of unknowns that they determine, if there are no more equations than unknowns. Repeated poses do not add equations:
/// they show only the repeatability, and from another station the place of that station.
pub fn without_redundancy(problem: &Problem<'_>) -> Option<(usize, usize)> {
    let points = with_weight(&problem.identify);
    let rank = problem.decomposition.rank();
    let of_robot = n_equations(&points, rank + 1);
    if of_robot <= rank {
        return Some((of_robot, rank));
    }
    let of_stations = problem.n_station_variables();
    if of_stations == 0 {
        return None;
    }
    let unknowns = rank + of_stations;
    let stations: BTreeSet<Option<usize>> = points.iter().map(|o| o.station).collect();
    let of_station = |station| {
        let own: Vec<Observation> = points
            .iter()
            .filter(|o| o.station == station)
            .cloned()
            .collect();
        n_equations(&own, unknowns + 1)
    };
    let equations = stations.into_iter().map(of_station).sum();
    (equations <= unknowns).then_some((equations, unknowns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::report::Errors;

    #[test]
    fn no_less_is_stated_of_the_links_than_kept_corrections_bring_the_points_nearer() {
        let errors = |rms_mm| Errors {
            mean_mm: rms_mm,
            std_mm: 0.0,
            rms_mm,
            max_mm: rms_mm,
        };
        let identify = |corrected| SubsetErrors {
            n_points: 10,
            before: errors(2.0),
            after: errors(0.5),
            corrected,
            rotation: None,
        };
        let of_links = ToolUncertainty {
            mean_mm: 0.1,
            max_mm: 0.45,
        };
        assert_eq!(with_found_misfit(of_links, &identify(None)), of_links);
        // corrections were searched, but none was kept
        let same = identify(Some(errors(0.5)));
        assert_eq!(with_found_misfit(of_links, &same), of_links);
        let stated = with_found_misfit(of_links, &identify(Some(errors(0.3))));
        assert!((stated.mean_mm - 0.4).abs() < 1e-12 && stated.max_mm == 0.45);
    }
}
