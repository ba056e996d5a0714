//! The flow chart of a calibration, stage by stage.

use crate::calibration::outcome::assemble::{Answer, report, verify_errors, verify_layout, vetoed};
use crate::calibration::preparation::check::check;
use crate::calibration::problem::Problem;
use crate::calibration::report::{CalibrationReport, MethodComparison};
use crate::calibration::request::{CalibrationRequest, Method};
use crate::calibration::session_comparison::{changes, estimate_of_request};
use crate::calibration::session_pool::compare_sessions;
use crate::calibration::solve::choice::{Choice, choose};
use crate::calibration::solve::corrections;
use crate::calibration::solve::final_fit::{self, final_fit};
use crate::calibration::solve::larger_model;
use crate::calibration::solve::solution::{Found, least_squares_from};
use crate::calibration::solve::swarms::{Start, swarm};
use crate::calibration::stages::{quiet, stage, watched};
use crate::calibration::validation::verification_set::Layout;
use crate::calibration::{Error, Monitor, NO_FIT};
use crate::identification::model::parameters::{Parameter, Quantity, quantity_mut};
use crate::identification::search::bpnn_pso;
use crate::kinematics::Link;
use crate::solvers::watch::Watch;
use std::f64::consts::TAU;

/// Runs one calibration. Pure: the same request gives the same report, bit for bit.
///
/// Several sessions are compared first. They are fitted together if they show the same robot in the same state.
///
/// # Errors
/// [`Error::Unusable`] if nothing can be identified from the request, [`Error::Cancelled`] when the monitor breaks.
pub fn calibrate(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    calibrate_with_problem(request, monitor, |report, _, _| Ok(report))
}

/// As [`calibrate`], and then calls `then` with the report and the problem that the delivered parameters were fitted to.
pub fn calibrate_with_problem<T>(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
    then: impl FnOnce(CalibrationReport, &Problem<'_>, &mut Monitor<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    let Some(pool) = compare_sessions(request, monitor)? else {
        let (report, problem) = calibrate_points(request, monitor)?;
        return then(report, &problem, monitor);
    };
    let weighed = CalibrationRequest {
        session_noise_mm: pool.noise_mm.clone(),
        ..request.clone()
    };
    let (mut report, problem) = calibrate_points(&weighed, monitor)?;
    report.pooled = Some(pool.report(request, &report.per_point));
    then(report, &problem, monitor)
}

/// Runs one calibration of points that belong to one state of the robot. Also returns the problem of the delivered parameters.
fn calibrate_points<'a>(
    request: &'a CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<(CalibrationReport, Problem<'a>), Error> {
    let (problem, choice) = stage(monitor, "screening", |monitor| {
        check(request)?;
        let problem = watched(monitor, |watch| Problem::new(request, watch)).flatten()?;
        let choice = choose(&problem);
        Ok((problem, choice))
    })?;
    let method = choice.method;
    let mut found = stage(monitor, method.as_str(), |monitor| match method {
        Method::Pso => swarm(&problem, &choice.start, Start::Cold, monitor),
        Method::BpnnPso => swarm(&problem, &choice.start, Start::Network, monitor),
        Method::Auto | Method::LeastSquares => least_squares_from(
            &problem,
            &choice.start,
            problem.settings.pso.stop_at_cost,
            monitor,
        ),
    })?;
    let mut problem = problem.with_stations_moved(&std::mem::take(&mut found.station_motions));
    let mut own = comparison_row(&problem, method.as_str(), method.as_str(), &found, None);
    let of_method = found.model.clone();
    let network = match (&found.swarm, method) {
        // The network predicts link parameters. Without free link parameters there is nothing to train.
        (Some((space, summary)), Method::Pso)
            if problem.parameters.iter().any(Parameter::is_link) =>
        {
            let train = || {
                bpnn_pso::train(
                    space,
                    &problem.nominal,
                    summary,
                    request.seed,
                    request.model(),
                    request.preset,
                )
            };
            Some(stage(monitor, "train_network", |_| Ok(train()))?)
        }
        _ => None,
    };
    if problem.settings.refine && method != Method::LeastSquares {
        let refined = stage(monitor, "refine", |monitor| {
            least_squares_from(&problem, &found.model, None, &mut quiet(monitor))
        })?;
        found.model = refined.model;
        problem = problem.with_stations_moved(&refined.station_motions);
    }
    found.model.links = with_angles_near_nominal(found.model.links, &problem.nominal.links);
    let too_small = larger_model::warning(&problem, &found.model, &mut quiet(monitor))?;
    let are_wanted = corrections::are_wanted(request.corrections, request.preset);
    let is_bounded = problem
        .priors
        .as_ref()
        .is_some_and(|known| known.priors.has_bounds());
    let corrections = match are_wanted && !is_bounded {
        true => stage(monitor, "corrections", |monitor| {
            Ok(Some(corrections::corrections(
                &problem,
                &found.model,
                monitor,
            )))
        })?,
        false => None,
    };
    // A separate verification set is screened once, with the identified robot.
    let layout = watched(monitor, |watch| verify_layout(request, &found.model, watch)).flatten()?;
    if layout.is_some() {
        own.verify_after = verify_errors(&problem, &of_method, layout.as_ref());
    }
    let comparison = compare(&problem, &choice, own, layout.as_ref(), monitor)?;
    let problem = problem.with_tool_of(&found.model);
    let (corrections, vetoed) = vetoed(&problem, &found.model, layout.as_ref(), corrections)?;
    let of_mounting = corrections::level_contradicts_mounting(&problem).or_else(|| {
        let found = corrections.as_ref()?;
        corrections::mounting_contradicted(&problem, found)
    });
    let (delivered, subsets_differ) = match final_fit::is_wanted(&problem) {
        true => stage(monitor, "final_fit", |monitor| {
            final_fit(&problem, &found.model, corrections.as_ref(), monitor)
        })?,
        false => (None, None),
    };
    let mut report = stage(monitor, "uncertainty", |monitor| {
        let assemble = |watch: &Watch<'_>| {
            report(
                &problem,
                Answer {
                    method,
                    method_reason: choice.reason,
                    found,
                    comparison,
                    network,
                    corrections,
                    delivered: delivered.as_ref(),
                },
                layout.as_ref(),
                watch,
            )
        };
        watched(monitor, assemble).flatten()
    })?;
    report.warnings.extend(vetoed);
    report.warnings.extend(of_mounting);
    report.warnings.extend(subsets_differ);
    report.warnings.extend(too_small);
    report
        .warnings
        .extend((are_wanted && is_bounded).then(corrections::left_out_for_bounds));
    // An estimate with stated priors does not depend on this session alone.
    let fitted = delivered.as_ref().filter(|_| request.priors.is_empty());
    report.estimate = fitted.and_then(|fit| fit.estimate.clone());
    // A model that does not fit the points shows nothing about changes of the robot.
    let is_no_fit = report.warnings.iter().any(|told| told.code == NO_FIT);
    if request.previous.is_some() && !is_no_fit {
        report.changes = stage(monitor, "compare_sessions", |monitor| {
            let own = match fitted {
                Some(_) => report.estimate.clone(),
                None => estimate_of_request(request, &mut quiet(monitor))?,
            };
            own.map_or(Ok(None), |own| changes(request, &own, &mut quiet(monitor)))
        })?;
        report.warnings.extend(
            report
                .changes
                .iter()
                .flat_map(|changes| changes.warnings.iter().cloned()),
        );
    }
    let problem = delivered.map_or(problem, |delivered| delivered.problem);
    Ok((report, problem))
}

/// The same links with each angle within half a turn of its nominal value. A fit from a distant start may be off by whole turns.
fn with_angles_near_nominal(mut links: Vec<Link>, nominal: &[Link]) -> Vec<Link> {
    for (link, nominal) in links.iter_mut().zip(nominal) {
        for quantity in [Quantity::Alpha, Quantity::ThetaOffset, Quantity::Beta] {
            let expected = *quantity_mut(&mut nominal.clone(), quantity);
            let angle = quantity_mut(link, quantity);
            let turns = ((*angle - expected) / TAU).round();
            if turns != 0.0 {
                *angle -= turns * TAU;
            }
        }
    }
    links
}

/// Runs other methods on the same points: least squares, unless it is the main method; for BPNN-PSO also the cold swarm and the plain warm
/// start.
fn compare(
    problem: &Problem<'_>,
    choice: &Choice,
    own: MethodComparison,
    layout: Option<&Layout<'_>>,
    monitor: &mut Monitor<'_>,
) -> Result<Vec<MethodComparison>, Error> {
    let mut rows = vec![own];
    let mut add = |method, name, run: &dyn Fn(&mut Monitor<'_>) -> Result<Found, Error>| {
        let found = stage(monitor, name, |monitor| run(&mut quiet(monitor)))?;
        rows.push(comparison_row(problem, method, name, &found, layout));
        Ok(())
    };
    if choice.method != Method::LeastSquares {
        add("least_squares", "compare_least_squares", &|monitor| {
            least_squares_from(problem, &problem.nominal, None, monitor)
        })?;
    }
    if choice.method == Method::BpnnPso {
        add("pso", "compare_pso", &|monitor| {
            swarm(problem, &choice.cold_start, Start::Cold, monitor)
        })?;
        add("warm_start", "compare_warm_start", &|monitor| {
            swarm(problem, &choice.start, Start::WarmBall, monitor)
        })?;
    }
    Ok(rows)
}

fn comparison_row(
    problem: &Problem<'_>,
    method: &'static str,
    stage: &'static str,
    found: &Found,
    layout: Option<&Layout<'_>>,
) -> MethodComparison {
    let is_moved = !found.station_motions.is_empty();
    let moved = is_moved.then(|| problem.clone().with_stations_moved(&found.station_motions));
    let problem = moved.as_ref().unwrap_or(problem);
    MethodComparison {
        method,
        stage,
        n_iterations: found.n_iterations,
        n_evaluations: found.n_evaluations,
        cost_mm2: problem.cost(&found.model),
        verify_after: verify_errors(problem, &found.model, layout),
    }
}
