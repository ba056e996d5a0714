//! Fits robot, placement and the motions between set-ups: between stations, and before and after a step.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::{
    Arrangement, FittedTargets, MIN_OF_SETUP, setup_placement, with_moved_targets,
};
use crate::calibration::preparation::observe::{
    Observed, free_parameters, nominal_model, placed, with_target_rotations,
};
use crate::calibration::request::CalibrationRequest;
use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::{estimate, least_squares_while};
use crate::identification::least_squares::linearisation::decomposition_at;
use crate::identification::least_squares::multistart::best_start;
use crate::identification::least_squares::problem::{Problem, reach_mm};
use crate::identification::model::identifiability::prior_scales;
use crate::identification::model::objective::{Observation, weighted_jacobian};
use crate::identification::model::parameters::Parameter;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, IsometryMatrix3, Vector3};

/// The free parameters of the request for the current arrangement of its points.
pub fn parameters_of(
    request: &CalibrationRequest,
    targets: &FittedTargets,
) -> Result<Vec<Parameter>, Error> {
    Ok(with_moved_targets(
        request,
        free_parameters(request, targets.len())?,
        targets,
    ))
}

/// Derivatives of the residuals by the observable combinations and by the motions of set-ups.
pub fn derivatives(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
) -> DMatrix<f64> {
    let scale = prior_scales(parameters, reach_mm(&model.links, observations.iter()));
    let directions =
        decomposition_at(model, parameters, &scale, observations).observable_directions();
    let seen = weighted_jacobian(model, parameters, observations, &Vector3::zeros()) * directions;
    let by_stations = Problem::new(model.clone(), &[], observations).with_stations(observations, 1);
    let (n_rows, n_seen) = (by_stations.n_rows(), seen.ncols());
    let n_stations = by_stations.variables.len();
    let (mut residuals, mut jacobian) = (vec![0.0; n_rows], DMatrix::zeros(n_rows, n_stations));
    by_stations.evaluate(&vec![0.0; n_stations], &mut residuals, Some(&mut jacobian));
    let mut all = seen.resize_horizontally(n_seen + n_stations, 0.0);
    // Points without weight have no block.
    let (mut row, mut block) = (0, 0);
    for o in observations {
        let n = o.n_rows(model);
        if o.weight > 0.0 {
            let of_block = jacobian.rows(by_stations.rows_of(block).start, n);
            all.view_mut((row, n_seen), (n, n_stations))
                .copy_from(&of_block);
            block += 1;
        }
        row += n;
    }
    all
}

/// First estimate of the stations' placements. Each is Kabsch's fit to the robot as placed by the station with the most points.
pub fn place_setups(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    watch: &Watch<'_>,
) -> Result<(), Error> {
    if arrangement.motions.len() < 2 {
        return Ok(());
    }
    let of = |setup: usize| -> Vec<Observation> {
        observed
            .all
            .iter()
            .zip(&arrangement.setups)
            .filter(|(_, s)| **s == setup)
            .map(|(o, _)| o.clone())
            .collect()
    };
    let n_setups = arrangement.motions.len();
    let largest = (0..n_setups)
        .max_by_key(|setup| (of(*setup).len(), std::cmp::Reverse(*setup)))
        .unwrap_or(0);
    let model = nominal_model(request, &of(largest), request.set.n_targets());
    let motions: Vec<_> = (0..n_setups)
        .map(|setup| setup_placement(&model, &of(setup)).inverse())
        .collect();
    arrangement.motions = motions;
    arrangement.set_reference();
    fit_motions(request, observed, arrangement, None, watch).map(|_| ())
}

/// Fits robot, placement and the motions between set-ups, as variables of one problem, and moves the set-ups. Set-ups with too few points keep
/// their place. With one set-up, a fit to a subset has nothing to do, and returns the nominal robot.
pub fn fit_motions(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    subset: Option<Subset>,
    watch: &Watch<'_>,
) -> Result<KinematicModel, Error> {
    let targets = arrangement.fitted_targets(observed);
    arrangement.apply(observed);
    let has_motions = arrangement.motions.len() > 1;
    if subset.is_some() && !has_motions {
        return Ok(KinematicModel::nominal(&request.robot.links, targets.len()));
    }
    let points = observed.all.iter().zip(&observed.subsets);
    let points = points.filter(|(o, of)| subset.is_none_or(|s| **of == s) && o.weight > 0.0);
    // Without motions, positions determine the robot. With motions, rotations of poses count too.
    let fitted: Vec<Observation> = match has_motions {
        true => points.map(|(o, _)| o.clone()).collect(),
        false => points.map(|(o, _)| o.position_alone()).collect(),
    };
    let parameters = with_target_rotations(parameters_of(request, &targets)?, &fitted);
    let nominal = nominal_model(request, &fitted, targets.len());
    let start = best_start(
        &nominal,
        None,
        &parameters,
        &fitted,
        request.stated_position_std_mm(),
        &|links, points| placed(request, links, points, targets.len()),
    )
    .model;
    let rows = Problem::new(nominal, &parameters, &fitted).with_stations(&fitted, 1);
    // A few poses of several set-ups leave no redundancy. Stated noise and priors then decide.
    let fit = match rows.usual_sigma_mm {
        None => least_squares_while(&rows, &start, watch),
        Some(_) => {
            let go_on = &mut |_| watch.flow();
            estimate(&rows, &rows.coordinates(&start), 0.0, go_on).into_summary()
        }
    };
    let n_of = |station: usize| fitted.iter().filter(|o| o.station == Some(station)).count();
    let stations = fit.station_motions.into_iter().enumerate();
    let motions: Vec<IsometryMatrix3<f64>> = stations
        .map(|(station, motion)| match n_of(station) < MIN_OF_SETUP {
            true => IsometryMatrix3::identity(),
            false => motion,
        })
        .collect();
    arrangement.move_stations(&motions);
    arrangement.apply(observed);
    // The searches that follow use positions only.
    Ok(KinematicModel {
        target_rotations: vec![],
        ..fit.model
    })
}
