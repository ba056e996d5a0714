//! Changes since the robot's last identification: compares two estimates, each from all points of its session.
//!
//! The earlier estimate is the one stored with the parameter set. If none was stored, or if its free link parameters are different, the earlier
//! session is fitted again in the same way as the new one.

use crate::calibration::outcome::stated_uncertainty::stated;
use crate::calibration::preparation::check::check;
use crate::calibration::preparation::observe::observe;
use crate::calibration::problem::Problem;
use crate::calibration::reference::InstrumentScale;
use crate::calibration::report::{ChangeKind, Changes, NamedChange, Warning};
use crate::calibration::request::{CalibrationRequest, PreviousSession};
use crate::calibration::solve::solution::least_squares_from;
use crate::calibration::stages::watched;
use crate::calibration::warning::probability_in_words;
use crate::calibration::warnings::overstated_noise::OverstatedNoise;
use crate::calibration::{Error, Monitor};
use crate::frames::PreliminaryFrames;
use crate::identification::model::identifiability::prior_scale;
use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::changes::{
    Change, Comparison, Estimate, FALSE_ALARMS, compare,
};
use crate::kinematics::reach_mm;
use crate::measurement::{Frame, MeasurementSet, Subset};

/// Code of the warning that the robot has changed.
pub const ROBOT_CHANGED: &str = "robot_changed";
/// A change is a jump if it exceeds this share of the expected errors of an uncalibrated robot (1 mm, 0.3°).
const JUMP_SHARE: f64 = 0.2;
/// A collision changes few parameters: at most this share of the combinations that both sessions determine.
const MAX_COLLISION_SHARE: f64 = 0.35;
/// Maximum number of changes that are listed by name. Further changes are only counted.
const LISTED: usize = 6;

/// Compares `own`, the estimate of the request's session, with the previous session that the request names. `None` if there is none, or if nothing
/// can be identified from it alone.
pub fn changes(
    request: &CalibrationRequest,
    own: &Estimate,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Changes>, Error> {
    let Some(previous) = &request.previous else {
        return Ok(None);
    };
    let before = match stored_estimate(previous, &own.parameters) {
        Some(stored) => Some(stored.clone()),
        None => {
            let (set, frames) = (previous.set.clone(), previous.frames.clone());
            estimate(&request_for_session(request, set, frames), monitor)?
        }
    };
    let compared = before.and_then(|before| compare(&before, own));
    Ok(compared.map(|comparison| in_words(&comparison, request)))
}

/// The stored estimate of an earlier session, if its free link parameters are those of `parameters`.
pub fn stored_estimate<'a>(
    previous: &'a PreviousSession,
    parameters: &[Parameter],
) -> Option<&'a Estimate> {
    let of_links = |parameters: &[Parameter]| -> Vec<Parameter> {
        parameters
            .iter()
            .copied()
            .filter(Parameter::is_link)
            .collect()
    };
    let stored = previous.estimate.as_ref()?;
    (of_links(&stored.parameters) == of_links(parameters)).then_some(stored)
}

/// The estimate of the request's own session, without its priors and options.
pub fn estimate_of_request(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Estimate>, Error> {
    let (set, frames) = (request.set.clone(), request.frames.clone());
    estimate(&request_for_session(request, set, frames), monitor)
}

/// A request for a session of the same robot, with the same model and free parameters, and all other options at their defaults.
fn request_for_session(
    request: &CalibrationRequest,
    set: MeasurementSet,
    frames: Option<PreliminaryFrames>,
) -> CalibrationRequest {
    CalibrationRequest {
        model: Some(request.model()),
        parameters: request.parameters.clone(),
        frames,
        ..CalibrationRequest::new(request.robot.clone(), set)
    }
}

/// The estimate of a session from all its points; `None` if its uncertainty cannot be stated.
pub fn estimate(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Estimate>, Error> {
    Ok(estimate_with_noise(request, monitor)?.map(|(estimate, _)| estimate))
}

/// As [`estimate`], with the session's stated noise if it is overstated.
pub fn estimate_with_noise(
    request: &CalibrationRequest,
    monitor: &mut Monitor<'_>,
) -> Result<Option<(Estimate, Option<OverstatedNoise>)>, Error> {
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
    let problem = problem
        .with_stations_moved(&found.station_motions)
        .with_tool_of(&found.model);
    let uncertainty = watched(monitor, |watch| stated(&problem, &found.model, watch))?;
    let noise = problem.noise(&found.model);
    let overstated = OverstatedNoise::of(&problem, &found.model);
    Ok(uncertainty.map(|uncertainty| {
        let estimate = Estimate {
            parameters: problem.parameters,
            model: found.model,
            uncertainty,
            corrected: None,
            noise,
        };
        (estimate, overstated)
    }))
}

fn in_words(comparison: &Comparison, request: &CalibrationRequest) -> Changes {
    let reach_mm = reach_mm(&request.robot.links);
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
             robot shows as much with probability {}){}",
            sentence(kind),
            list(&robot.changes.iter().collect::<Vec<_>>()),
            robot.chi_square,
            robot.n_combinations,
            probability_in_words(robot.probability),
            scale_remark(request)
        );
        warnings.push(Warning::new(ROBOT_CHANGED, detail));
    }
    // Each set-up of the instrument has its own base, so a difference of bases is no change.
    let is_own = |change: &&Change| {
        let is_base = matches!(
            change.parameters[0],
            Parameter::BaseTranslation(_) | Parameter::BaseRotation(_)
        );
        !(is_base && request.set.frame == Frame::Instrument)
    };
    let elsewhere: Vec<&Change> = placement.iter().copied().filter(is_own).collect();
    if !elsewhere.is_empty() {
        let and = if kind.is_none() {
            "; the robot itself has not changed beyond chance"
        } else {
            ""
        };
        let detail = format!(
            "the base in its frame, or targets on the tool, are elsewhere than at the last identification, which is no change of the robot{and}: {}",
            list(&elsewhere)
        );
        warnings.push(Warning::new("placement_changed", detail));
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

/// Sentence for the message that two sessions differ: the reference shows a scale error of the instrument. Empty if it shows none.
pub fn scale_remark(request: &CalibrationRequest) -> String {
    let is_off = |scale: &InstrumentScale| scale.is_off();
    let Some(scale) = request.instrument_scale.filter(is_off) else {
        return String::new();
    };
    format!(
        ". But the reference that was measured shows an instrument whose lengths are {:+.1} ppm off, which looks like changed lengths of the robot: set \
         its temperature and scale right and measure again first",
        1e6 * scale.error
    )
}

fn kind(changes: &[Change], n_combinations: usize, reach_mm: f64) -> ChangeKind {
    let jumps = changes
        .iter()
        .any(|c| c.delta.abs() > JUMP_SHARE * prior_scale(&c.parameters[0], reach_mm));
    match (
        jumps,
        changes.len() as f64 <= MAX_COLLISION_SHARE * n_combinations as f64,
    ) {
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
    NamedChange {
        name: change.name(),
        delta: change.parameters[0].in_unit(change.delta),
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
        format!("{name} by {delta:.4}{unit} ({sigmas:.1} standard deviations)")
    };
    let mut items: Vec<String> = changes.iter().take(LISTED).map(item).collect();
    if changes.len() > LISTED {
        items.push(format!("and {} more", changes.len() - LISTED));
    }
    items.join(", ")
}
