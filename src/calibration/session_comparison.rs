//! What changed since the robot's last identification: both sessions fitted alike, on all of their points, and compared.

use crate::calibration::outcome::stated_uncertainty::stated;
use crate::calibration::preparation::check::check;
use crate::calibration::preparation::observe::observe;
use crate::calibration::problem::Problem;
use crate::calibration::report::{ChangeKind, Changes, NamedChange, Warning};
use crate::calibration::request::CalibrationRequest;
use crate::calibration::solve::final_fit::Final;
use crate::calibration::solve::solution::least_squares_from;
use crate::calibration::stages::watched;
use crate::calibration::{Error, Monitor};
use crate::identification::changes::{Change, Comparison, Estimate, FALSE_ALARMS, compare};
use crate::identification::identifiability::prior_scale;
use crate::identification::parameters::Parameter;
use crate::kinematics::reach_mm;
use crate::measurement::Subset;

/// A change by more than this share of what a fresh robot is expected to be off (1 mm, 0.3°) is a jump.
const JUMP: f64 = 0.2;
/// A collision moves few things: at most this share of what both sessions see.
const FEW: f64 = 0.35;
/// More changes than these are counted, not listed, in words.
const LISTED: usize = 6;

/// Below this a probability is only said to be below it.
const LEAST_PROBABILITY: f64 = 1e-9;

/// Compares the request's session with the one that it names as previous. `None` where there is none, or where one of them cannot be
/// identified from by itself. The fit to all points of the request's session may be known already (`fitted`).
///
/// # Errors
/// [`Error::Cancelled`].
pub fn changes(
    request: &CalibrationRequest,
    fitted: Option<&Final<'_>>,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Changes>, Error> {
    let Some(previous) = &request.previous else {
        return Ok(None);
    };
    let alike = |set, frames| CalibrationRequest {
        model: Some(request.model()),
        parameters: request.parameters.clone(),
        frames,
        ..CalibrationRequest::new(request.robot.clone(), set)
    };
    let before = alike(previous.set.clone(), previous.frames.clone());
    let after = match fitted {
        Some(fitted) => fitted.estimate(),
        None => estimate(&alike(request.set.clone(), request.frames.clone()), monitor)?,
    };
    let Some(after) = after else {
        return Ok(None);
    };
    let Some(before) = estimate(&before, monitor)? else {
        return Ok(None);
    };
    Ok(compare(&before, &after)
        .map(|comparison| in_words(&comparison, reach_mm(&request.robot.links))))
}

/// What a session says of its own, from all its points; `None` where it cannot be said how sure that is.
pub fn estimate(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Estimate>, Error> {
    let observed = observe(request).map(|mut observed| {
        observed.subsets.fill(Subset::Identify);
        observed
    });
    let Ok(observed) = observed else {
        return Ok(None);
    };
    if check(request).is_err() {
        return Ok(None);
    }
    let problem = watched(monitor, |watch| Problem::of(request, observed, watch)).flatten()?;
    let found = least_squares_from(&problem, &problem.nominal, None, monitor)?;
    if !matches!(found.termination, "converged" | "cost_reached") {
        return Ok(None);
    }
    let problem = problem.with_tool_of(&found.model);
    let uncertainty = watched(monitor, |watch| stated(&problem, &found.model, watch))?;
    let noise = problem.noise(&found.model);
    Ok(uncertainty.map(|uncertainty| Estimate {
        parameters: problem.parameters,
        model: found.model,
        uncertainty,
        noise,
    }))
}

fn in_words(comparison: &Comparison, reach_mm: f64) -> Changes {
    let robot = &comparison.robot;
    let placement: Vec<&Change> = comparison
        .placement
        .iter()
        .flat_map(|tested| &tested.changes)
        .collect();
    let mut warnings = Vec::new();
    let kind = (robot.probability < FALSE_ALARMS)
        .then(|| kind(&robot.changes, robot.n_combinations, reach_mm));
    if let Some(kind) = kind {
        let detail = format!(
            "since its last identification the robot has changed: {}: {} (chi-square {:.1} of {} combinations that both sessions see; an unchanged \
             robot shows as much with probability {})",
            sentence(kind),
            list(&robot.changes.iter().collect::<Vec<_>>()),
            robot.chi_square,
            robot.n_combinations,
            if robot.probability < LEAST_PROBABILITY {
                "below 1e-9".into()
            } else {
                format!("{:.1e}", robot.probability)
            }
        );
        warnings.push(Warning {
            code: "robot_changed",
            detail,
            rows: vec![],
        });
    }
    if !placement.is_empty() {
        let and = if kind.is_none() {
            "; the robot itself has not changed beyond chance"
        } else {
            ""
        };
        let detail = format!(
            "the base as seen from the instrument, or targets on the tool, are elsewhere than at the last identification, which is no change of \
             the robot{and}: {}",
            list(&placement)
        );
        warnings.push(Warning {
            code: "placement_changed",
            detail,
            rows: vec![],
        });
    }
    Changes {
        all: robot.changes.iter().chain(placement).map(named).collect(),
        kind,
        warnings,
        chi_square: robot.chi_square,
        n_combinations: robot.n_combinations,
        probability: robot.probability,
    }
}

fn kind(changes: &[Change], n_combinations: usize, reach_mm: f64) -> ChangeKind {
    let jumps = changes
        .iter()
        .any(|c| c.delta.abs() > JUMP * prior_scale(&c.parameters[0], reach_mm));
    match (jumps, changes.len() as f64 <= FEW * n_combinations as f64) {
        (false, _) => ChangeKind::Drift,
        (true, true) => ChangeKind::Collision,
        (true, false) => ChangeKind::Rebuilt,
    }
}

fn sentence(kind: ChangeKind) -> &'static str {
    match kind {
        ChangeKind::Drift => "small changes, as of drift",
        ChangeKind::Collision => "a jump in few parameters, as after a collision",
        ChangeKind::Rebuilt => {
            "jumps in many parameters, as after an exchange of parts, or of another robot"
        }
    }
}

fn named(change: &Change) -> NamedChange {
    let is_angle = change.parameters[0].is_angle();
    let names: Vec<String> = change.parameters.iter().map(Parameter::name).collect();
    NamedChange {
        name: names.join(" or "),
        delta: if is_angle {
            change.delta.to_degrees()
        } else {
            change.delta
        },
        sigmas: change.sigmas,
    }
}

/// Changes with their size, the first ones by name.
pub fn list(changes: &[&Change]) -> String {
    let item = |change: &&Change| {
        let NamedChange {
            name,
            delta,
            sigmas,
        } = named(change);
        let unit = if change.parameters[0].is_angle() {
            "°"
        } else {
            " mm"
        };
        format!("{name} by {delta:.4}{unit} ({sigmas:.1} σ)")
    };
    let mut items: Vec<String> = changes.iter().take(LISTED).map(item).collect();
    if changes.len() > LISTED {
        items.push(format!("and {} more", changes.len() - LISTED));
    }
    items.join(", ")
}
