//! The flow chart of a calibration, stage by stage.

use crate::calibration::outcome::assemble::{Answer, report, verify_errors, verify_layout, vetoed};
use crate::calibration::preparation::check::check;
use crate::calibration::problem::Problem;
use crate::calibration::report::{CalibrationReport, MethodComparison};
use crate::calibration::request::{CalibrationRequest, Method};
use crate::calibration::session_comparison::changes;
use crate::calibration::solve::choice::{Choice, choose};
use crate::calibration::solve::corrections;
use crate::calibration::solve::final_fit::{self, final_fit};
use crate::calibration::solve::larger_model;
use crate::calibration::solve::solution::{Found, least_squares_from};
use crate::calibration::solve::swarms::{Start, swarm};
use crate::calibration::stages::{quiet, stage};
use crate::calibration::{Error, Monitor};
use crate::identification::bpnn_pso;
use crate::identification::parameters::{Parameter, Quantity, quantity_mut};
use crate::kinematics::Link;
use std::f64::consts::TAU;

/// Runs one calibration. Pure: the same request gives the same report, bit for bit.
///
/// # Errors
/// [`Error::Unusable`] for a request that cannot be identified from, [`Error::Cancelled`] when the monitor breaks.
pub fn calibrate(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<CalibrationReport, Error> {
    let (problem, choice) = stage(monitor, "screening", |_| {
        check(request)?;
        let problem = Problem::new(request)?;
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
    let own = comparison_row(&problem, method.as_str(), method.as_str(), &found);
    let network = match (&found.swarm, method) {
        // a network speaks of link parameters; where none is free there is nothing for it to learn
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
    }
    found.model.links = unwound(found.model.links, &problem.nominal.links);
    let too_small = larger_model::warning(&problem, &found.model, &mut quiet(monitor))?;
    let are_wanted = corrections::are_wanted(request.corrections, request.preset);
    let has_poses = request.set.has_poses();
    let corrections = match are_wanted && problem.priors.is_none() && !has_poses {
        true => stage(monitor, "corrections", |monitor| {
            Ok(Some(corrections::corrections(
                &problem,
                &found.model,
                monitor,
            )))
        })?,
        false => None,
    };
    let comparison = compare(&problem, &choice, own, monitor)?;
    let problem = problem.with_tool_of(&found.model);
    let layout = verify_layout(&problem, &found.model)?;
    let (corrections, vetoed) = vetoed(&problem, &found.model, layout.as_ref(), corrections)?;
    let (delivered, subsets_differ) = match final_fit::is_wanted(&problem) {
        true => stage(monitor, "final_fit", |monitor| {
            final_fit(&problem, &found.model, corrections.as_ref(), monitor)
        })?,
        false => (None, None),
    };
    let mut report = stage(monitor, "uncertainty", |_| {
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
        )
    })?;
    report.warnings.extend(vetoed);
    report.warnings.extend(subsets_differ);
    report.warnings.extend(too_small);
    report
        .warnings
        .extend((are_wanted && problem.priors.is_some()).then(corrections::left_out_for_priors));
    report
        .warnings
        .extend((are_wanted && has_poses).then(corrections::left_out_for_poses));
    if request.previous.is_some() {
        report.changes = stage(monitor, "compare_sessions", |monitor| {
            let fitted = delivered.as_ref().filter(|_| request.priors.is_empty());
            changes(request, fitted, &mut quiet(monitor))
        })?;
        report.warnings.extend(
            report
                .changes
                .iter()
                .flat_map(|changes| changes.warnings.iter().cloned()),
        );
    }
    Ok(report)
}

/// The same robot with each angle within half a turn of its nominal value: a fit that came from afar may have gone round.
fn unwound(mut links: Vec<Link>, nominal: &[Link]) -> Vec<Link> {
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

/// The other methods on the same points: always least squares; for BPNN-PSO also the cold swarm and the plain warm start.
fn compare(
    problem: &Problem<'_>,
    choice: &Choice,
    own: MethodComparison,
    monitor: &mut Monitor<'_>,
) -> Result<Vec<MethodComparison>, Error> {
    let mut rows = vec![own];
    if choice.method != Method::LeastSquares {
        let other = stage(monitor, "compare_least_squares", |monitor| {
            least_squares_from(problem, &problem.nominal, None, &mut quiet(monitor))
        })?;
        rows.push(comparison_row(
            problem,
            "least_squares",
            "compare_least_squares",
            &other,
        ));
    }
    if choice.method == Method::BpnnPso {
        let cold = stage(monitor, "compare_pso", |monitor| {
            swarm(
                problem,
                &choice.cold_start,
                Start::Cold,
                &mut quiet(monitor),
            )
        })?;
        rows.push(comparison_row(problem, "pso", "compare_pso", &cold));
        let warm = stage(monitor, "compare_warm_start", |monitor| {
            swarm(problem, &choice.start, Start::WarmBall, &mut quiet(monitor))
        })?;
        rows.push(comparison_row(
            problem,
            "warm_start",
            "compare_warm_start",
            &warm,
        ));
    }
    Ok(rows)
}

fn comparison_row(
    problem: &Problem<'_>,
    method: &'static str,
    stage: &'static str,
    found: &Found,
) -> MethodComparison {
    MethodComparison {
        method,
        stage,
        n_iterations: found.n_iterations,
        n_evaluations: found.n_evaluations,
        cost_mm2: problem.cost(&found.model),
        verify_after: verify_errors(problem, &found.model),
    }
}
