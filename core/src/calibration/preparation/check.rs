//! Checks of a request that need no fit.

use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::equations::{generic_jacobian, model_rank, n_equations};
use crate::calibration::preparation::observe::{
    DEFAULT_VERIFY_FRACTION, free_parameters, nominal_model, observe, with_target_rotations,
};
use crate::calibration::request::{CalibrationRequest, Loss, Method, Model, Preset, VerifySource};
use crate::calibration::settings::settings;
use crate::calibration::settings::{box_too_small, half_widths};
use crate::calibration::validation::enough_points::check_verify_set;
use crate::calibration::{Error, unusable};
use crate::identification::TrainedNetwork;
use crate::identification::least_squares::linearisation::decomposition_at;
use crate::identification::model::objective::Observation;
use crate::identification::model::parameters::Parameter;
use crate::identification::search::bpnn_pso::fits;
use crate::measurement::split::{MIN_OF_REFERENCE, has_column};
use crate::measurement::{Frame, Subset};
use std::collections::BTreeSet;

/// Movements below this count as zero, mm. The sine of a half turn is not exactly zero.
const UNMOVED_MM: f64 = 1e-9;

/// Limit for the swarm's work in a job, in evaluations of one particle at one point: some minutes of one core.
const MAX_POINT_EVALUATIONS: usize = 100_000_000_000;

/// The checks of `calibrate` that need no fit. They also run when a job is posted.
///
/// # Errors
/// [`Error::Unusable`] with code `poses_not_supported`, `loss_not_supported`, `frames_required`, `model_mismatch`, `no_network`, `network_mismatch`,
/// `unknown_parameter`, `bad_subset`, `target_without_identify_points`, `under_determined`, `nothing_to_identify`, `too_much_work`,
/// `search_box_too_small`, `verify_overlaps_identify`.
pub fn check(request: &CalibrationRequest) -> Result<(), Error> {
    check_poses(request)?;
    check_loss(request)?;
    check_model(request)?;
    let observed = observe(request)?;
    let n_targets = n_targets(request);
    let parameters = with_target_rotations(free_parameters(request, n_targets)?, &observed.all);
    check_network(request, &parameters)?;
    let identify = observed.of(Subset::Identify);
    check_targets(request, &identify, n_targets)?;
    check_determined(request, &identify, &parameters)?;
    check_stations(request, &observed.subsets)?;
    check_work(request, identify.len())?;
    check_search_box(request, &identify, &parameters)?;
    match &request.verify {
        VerifySource::Set(set) => check_verify_set(request, set),
        _ => Ok(()),
    }
}

/// Number of targets of the request's own set. Targets of a verify set are fitted to that set.
pub fn n_targets(request: &CalibrationRequest) -> usize {
    request.set.n_targets()
}

fn check_model(request: &CalibrationRequest) -> Result<(), Error> {
    if request.model() != Model::Paper {
        return Ok(());
    }
    if request.set.frame == Frame::Instrument && request.frames.is_none() {
        let detail = "model \"paper\" needs positions in the base frame: upload sweeps of joints 1, 2 and 5 to the robot's frames and name frames_id, \
                      upload the set in the frame base, or choose model complete";
        return Err(unusable("frames_required", detail));
    }
    if request.set.n_targets() > 1 {
        let detail = "model \"paper\" has one target on the flange axis, the set has several; choose model complete";
        return Err(unusable("model_mismatch", detail));
    }
    Ok(())
}

/// Refuses jobs with poses that are not supported.
fn check_poses(request: &CalibrationRequest) -> Result<(), Error> {
    if !request.set.has_poses() {
        return Ok(());
    }
    let refused = match request.method {
        _ if request.model() == Model::Paper => {
            "model \"paper\" is identified from positions, and the set has poses: choose model complete, or upload the set without its \
             rotation columns"
        }
        Method::Pso | Method::BpnnPso => {
            "swarms take positions alone, and the set has poses: choose method auto or least_squares, or upload the set without its \
             rotation columns"
        }
        Method::Auto | Method::LeastSquares => return Ok(()),
    };
    Err(unusable("poses_not_supported", refused))
}

/// Refuses robust losses with the paper's preset: it has no screening, which gives a robust loss its scale.
fn check_loss(request: &CalibrationRequest) -> Result<(), Error> {
    let loss = request.options.loss.unwrap_or(Loss::Squares);
    if request.preset != Preset::Paper || loss == Loss::Squares {
        return Ok(());
    }
    let detail = "preset \"paper\" minimises the sum of squares: leave options.loss out, or choose preset \"default\"";
    Err(unusable("loss_not_supported", detail))
}

/// True if the request may start from this network: trained on the same model and link parameters.
pub fn network_fits(request: &CalibrationRequest, network: &TrainedNetwork) -> bool {
    let parameters = free_parameters(request, n_targets(request));
    network.model == request.model()
        && parameters.is_ok_and(|parameters| fits(network, &parameters))
}

fn check_network(request: &CalibrationRequest, parameters: &[Parameter]) -> Result<(), Error> {
    match (&request.network, request.method) {
        (None, Method::BpnnPso) => {
            let detail = "the robot has no trained network of this model and preset; run a job with method \"pso\" first";
            Err(unusable("no_network", detail))
        }
        (Some(network), Method::BpnnPso | Method::Auto)
            if !fits(network, parameters) || network.model != request.model() =>
        {
            let detail = "the network was trained on other parameters than this job identifies; run a job with method \"pso\" and the same model, preset and \
                          parameters first, or name a network_id that fits";
            Err(unusable("network_mismatch", detail))
        }
        _ => Ok(()),
    }
}

fn check_targets(
    request: &CalibrationRequest,
    identify: &[Observation],
    n_targets: usize,
) -> Result<(), Error> {
    // A set without identify rows is refused later, by the count of equations.
    if request.model() == Model::Paper || identify.is_empty() {
        return Ok(());
    }
    match (0..n_targets).find(|target| !identify.iter().any(|o| o.target == *target)) {
        Some(target) => {
            let detail = format!(
                "target {target} has no row in the identify subset, so its offset cannot be identified; number targets from 0 without gaps"
            );
            Err(unusable("target_without_identify_points", detail))
        }
        None => Ok(()),
    }
}

/// Refuses sets with fewer equations from distinct configurations than the model's rank.
fn check_determined(
    request: &CalibrationRequest,
    identify: &[Observation],
    parameters: &[Parameter],
) -> Result<(), Error> {
    let names = || {
        let names: Vec<_> = parameters.iter().map(Parameter::name).collect();
        match names.len().saturating_sub(MAX_NAMED) {
            0 => names.join(", "),
            more => format!("{} and {more} more", names[..MAX_NAMED].join(", ")),
        }
    };
    let n_targets = n_targets(request);
    // One pose per target shows whether any parameter is observable at all.
    let seen = generic_jacobian(&request.robot, parameters, n_targets, n_targets.max(1));
    if seen.iter().all(|moved| moved.abs() < UNMOVED_MM) {
        let detail = format!(
            "no measured position depends on {} in this model: free other parameters as well",
            names()
        );
        return Err(unusable("nothing_to_identify", detail));
    }
    // The rank cannot exceed the number of parameters.
    let found = n_equations(identify, parameters.len());
    if found >= parameters.len() {
        return Ok(());
    }
    let needed = model_rank(&request.robot, parameters, n_targets);
    if found < needed {
        let per_configuration = if request.set.has_poses() { 6 } else { 3 };
        let more =
            ((needed - found).div_ceil(per_configuration) as f64 / identify_share(request)).ceil();
        let detail = format!(
            "{found} equations from distinct configurations in the identify subset cannot fix {needed} independent parameters ({}); measure at least {more} more \
             configurations, spread over the workspace, or hold parameters",
            names()
        );
        return Err(unusable("under_determined", detail));
    }
    Ok(())
}

/// Maximum number of parameters that a refusal names.
const MAX_NAMED: usize = 8;

/// Share of new configurations that goes to the identify subset.
fn identify_share(request: &CalibrationRequest) -> f64 {
    let verify_share = match request.verify {
        VerifySource::Fraction(fraction) => fraction,
        VerifySource::Default if !has_column(&request.set) => DEFAULT_VERIFY_FRACTION,
        VerifySource::Default | VerifySource::Set(_) | VerifySource::Subset => 0.0,
    };
    // A share of zero would require infinitely many configurations.
    (1.0 - verify_share).max(0.01)
}

/// Refuses sets whose reference station has too few configurations. An error of its base would change every link and show at no point.
fn check_stations(request: &CalibrationRequest, subsets: &[Subset]) -> Result<(), Error> {
    let arrangement = Arrangement::of(request);
    let reference_setup = arrangement.reference_setup();
    let is_fitted = |point: &usize| {
        arrangement.setups[*point] == reference_setup && subsets[*point] == Subset::Identify
    };
    let fitted = (0..subsets.len())
        .filter(is_fitted)
        .map(|point| request.set.points[point].configuration.as_str());
    let n = fitted.collect::<BTreeSet<_>>().len();
    if arrangement.motions.len() < 2 || n >= MIN_OF_REFERENCE {
        return Ok(());
    }
    let (place, frame) = if arrangement.is_last_reference {
        ("last", "the instrument")
    } else {
        ("first", "the base")
    };
    let station = arrangement
        .setups
        .iter()
        .position(|setup| *setup == reference_setup)
        .and_then(|point| request.set.points[point].station.as_deref());
    let detail = format!(
        "positions of all stations are brought into the frame of {frame} as the {place} station, {:?}, has it, and that one has {n} configurations to \
         identify from; it takes {MIN_OF_REFERENCE}: measure more there, or leave its rows out",
        station.unwrap_or("")
    );
    Err(unusable("under_determined", detail))
}

/// Limits the product of particles, iterations and points. Each factor also has its own limit.
fn check_work(request: &CalibrationRequest, n_points: usize) -> Result<(), Error> {
    // Least squares needs tens of evaluations. `bpnn_pso` runs three swarms, two of them for the comparison. `auto` may choose either
    // method, but never a swarm for poses.
    let n_swarms = match request.method {
        Method::LeastSquares => return Ok(()),
        Method::Auto if request.set.has_poses() => return Ok(()),
        Method::Pso => 1,
        Method::Auto if request.network.is_none() => 1,
        Method::Auto | Method::BpnnPso => 3,
    };
    let pso = settings(request).pso;
    let work = [pso.n_particles, pso.n_iterations + 1, n_points]
        .into_iter()
        .fold(n_swarms, usize::saturating_mul);
    if work > MAX_POINT_EVALUATIONS {
        let detail = format!(
            "{} particles × {} iterations × {n_points} points × {n_swarms} swarms are {work:.1e} evaluations; at most {MAX_POINT_EVALUATIONS:.0e} \
             are allowed: take fewer particles or iterations, identify from fewer points, or choose method least_squares",
            pso.n_particles,
            pso.n_iterations,
            work = work as f64,
            MAX_POINT_EVALUATIONS = MAX_POINT_EVALUATIONS as f64
        );
        return Err(unusable("too_much_work", detail));
    }
    Ok(())
}

/// Refuses a search box that is too small for a swarm along singular vectors: its effect must be visible in the data.
fn check_search_box(
    request: &CalibrationRequest,
    identify: &[Observation],
    parameters: &[Parameter],
) -> Result<(), Error> {
    let (settings, options) = (settings(request), &request.options);
    let is_asked_for =
        options.search_half_width_mm.is_some() || options.search_half_width_deg.is_some();
    // Stated priors define their own search directions.
    if !is_asked_for
        || !request.priors.is_empty()
        || !settings.singular_directions
        || !matches!(request.method, Method::Pso | Method::BpnnPso)
    {
        return Ok(());
    }
    let model = nominal_model(request, identify, n_targets(request));
    let decomposition = decomposition_at(
        &model,
        parameters,
        &half_widths(&settings, parameters),
        identify,
    );
    if decomposition.rank() == 0 {
        Err(box_too_small(decomposition.visible_mm))
    } else {
        Ok(())
    }
}
