//! Fits robot, placement and the motions between set-ups: between stations, and before and after a step.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::{
    Arrangement, FittedTargets, MIN_OF_SETUP, motion, setup_placement, with_moved_targets,
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
use crate::identification::model::objective::{Observation, weighted_jacobian, weighted_residuals};
use crate::identification::model::parameters::Parameter;
use crate::identification::model::pose_rows::rows_by_turn;
use crate::identification::screening::columns::Columns;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, DVector, Vector3};

/// Maximum number of fits of the motions between set-ups. Each is a Gauss-Newton step; two are usual.
const MOTION_FITS: usize = 6;
/// Motions have converged if they change the points by less than this share of the reach: a nanometre on an arm of 1.7 m.
const MOTION_FOUND_PER_REACH: f64 = 1e-6 / 1700.0;

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

fn n_of(arrangement: &Arrangement, points: &[usize], setup: usize) -> usize {
    let is_of_setup = |point: &&usize| arrangement.setups[**point] == setup;
    points.iter().filter(is_of_setup).count()
}

/// Set-ups whose motions are fitted to `points`. One set-up is held, because the base already describes a motion common to all. The held
/// one is the reference set-up, or the last set-up with enough points if the reference has too few.
fn moving(arrangement: &Arrangement, points: &[usize]) -> Vec<usize> {
    let n_of = |setup: usize| n_of(arrangement, points, setup);
    let in_reverse = arrangement.order.iter().rev();
    let held = std::iter::once(arrangement.reference_setup())
        .chain(in_reverse.map(|point| arrangement.setups[*point]))
        .find(|setup| n_of(*setup) >= MIN_OF_SETUP)
        .unwrap_or(arrangement.reference_setup());
    (0..arrangement.motions.len())
        .filter(|setup| *setup != held && n_of(*setup) > 0)
        .collect()
}

/// Derivatives of the residuals by the observable combinations and by the fitted motions of set-ups.
pub fn derivatives(
    model: &KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
    columns: &Columns,
    arrangement: &Arrangement,
    points: &[usize],
) -> DMatrix<f64> {
    let scale = prior_scales(parameters, reach_mm(&model.links, observations.iter()));
    let directions =
        decomposition_at(model, parameters, &scale, observations).observable_directions();
    let seen = weighted_jacobian(model, parameters, observations, &Vector3::zeros()) * directions;
    let moving = moving(arrangement, points);
    let n_seen = seen.ncols();
    let mut all = seen.resize_horizontally(n_seen + 6 * moving.len(), 0.0);
    let mut row = 0;
    for (o, point) in observations.iter().zip(points) {
        let setup = arrangement.setups[*point];
        if let Some(k) = moving.iter().position(|moving| *moving == setup) {
            let first = n_seen + 6 * k;
            let mut here = all.fixed_view_mut::<3, 6>(row, first);
            here.copy_from(columns.base(*point));
            let posed = o.rotation.as_ref().zip(model.rotation(&o.q_rad, o.target));
            if let Some((measured, predicted)) = posed {
                // A motion of the measured points changes the residual like the opposite motion of the predicted ones.
                let per_unit = o.weight.sqrt() * measured.mm_per_rad / columns.size_mm();
                let turned = rows_by_turn(&predicted, measured) * per_unit;
                all.fixed_view_mut::<3, 3>(row + 3, first + 3)
                    .copy_from(&turned);
                if let Some(coupling) = o.coupling() {
                    let mut here = all.fixed_view_mut::<3, 3>(row, first + 3);
                    here += coupling * turned;
                }
            }
        }
        row += o.n_rows(model);
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

/// Fits robot, placement and the motions between set-ups. Least squares with held motions alternates with Gauss-Newton steps of all unknowns. Without
/// motions it is least squares alone. Set-ups with too few points keep their motion.
pub fn fit_motions(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    subset: Option<Subset>,
    watch: &Watch<'_>,
) -> Result<KinematicModel, Error> {
    let targets = arrangement.fitted_targets(observed);
    let parameters = parameters_of(request, &targets)?;
    let points: Vec<usize> = (0..observed.all.len())
        .filter(|p| {
            subset.is_none_or(|s| observed.subsets[*p] == s) && observed.all[*p].weight > 0.0
        })
        .collect();
    // Without motions, positions determine the robot. With motions, rotations of poses count too.
    let has_motions = arrangement.motions.len() > 1;
    let fitted_of = |observed: &Observed| -> Vec<Observation> {
        let all = points.iter().map(|p| &observed.all[*p]);
        match has_motions {
            true => all.cloned().collect(),
            false => all.map(Observation::position_alone).collect(),
        }
    };
    let parameters = with_target_rotations(parameters, &fitted_of(observed));
    let (mut nominal, mut model) = (None, None);
    let stated_std_mm = request.stated_position_std_mm();
    for _ in 0..MOTION_FITS {
        arrangement.apply(observed);
        if subset.is_some() && !has_motions {
            break;
        }
        let fitted = fitted_of(observed);
        let nominal =
            &*nominal.get_or_insert_with(|| nominal_model(request, &fitted, targets.len()));
        let start = model.take().unwrap_or_else(|| {
            best_start(
                nominal,
                None,
                &parameters,
                &fitted,
                stated_std_mm,
                &|links, points| placed(request, links, points, targets.len()),
            )
            .model
        });
        let rows = Problem::new(nominal.clone(), &parameters, &fitted);
        // A few poses of several set-ups leave no redundancy. Stated noise and priors then decide.
        let (fit, noise_mm) = match rows.usual_sigma_mm {
            None => {
                let fit = least_squares_while(&rows, &start, watch);
                (fit, rows.least_sigma_mm)
            }
            Some(_) => {
                let go_on = &mut |_| watch.flow();
                let found = estimate(&rows, &rows.coordinates(&start), 0.0, go_on);
                (found.model, found.evidence.sigma_mm)
            }
        };
        let found = !has_motions || {
            let points = (points.as_slice(), fitted.as_slice());
            move_setups((&fit, &parameters), observed, arrangement, points, noise_mm)
        };
        model = Some(fit);
        if found || watch.was_stopped() {
            break;
        }
    }
    let nominal = || KinematicModel::nominal(&request.robot.links, targets.len());
    // The searches that follow use positions only.
    Ok(KinematicModel {
        target_rotations: vec![],
        ..model.unwrap_or_else(nominal)
    })
}

/// One Gauss-Newton step of the motions together with all other unknowns. It starts from the most probable robot for the present motions.
/// Returns true if the step is small. `noise_mm` is a lower bound of the noise of a coordinate.
fn move_setups(
    (model, parameters): (&KinematicModel, &[Parameter]),
    observed: &Observed,
    arrangement: &mut Arrangement,
    (points, fitted): (&[usize], &[Observation]),
    noise_mm: f64,
) -> bool {
    let columns = Columns::new(model, &observed.all);
    let derivatives = derivatives(model, parameters, fitted, &columns, arrangement, points);
    let moving = moving(arrangement, points);
    let n_seen = derivatives.ncols() - 6 * moving.len();
    let residuals = weighted_residuals(model, fitted);
    let noise_mm = noise_mm.max((residuals.norm_squared() / residuals.len().max(1) as f64).sqrt());
    let Some(solution) = most_probable_step(derivatives, &residuals, n_seen, noise_mm) else {
        return true;
    };
    let mut largest = 0.0f64;
    for (k, setup) in moving.into_iter().enumerate() {
        if n_of(arrangement, points, setup) < MIN_OF_SETUP {
            continue;
        }
        let (shift_mm, turn_rad) = columns.motion(&solution[n_seen + 6 * k..n_seen + 6 * k + 6]);
        largest = largest.max(shift_mm.norm() + turn_rad.norm() * columns.size_mm());
        // The step moves the measured points; its inverse transforms them back.
        arrangement.motions[setup] =
            motion(&shift_mm, &turn_rad, &columns.centre).inverse() * arrangement.motions[setup];
    }
    largest <= MOTION_FOUND_PER_REACH * reach_mm(&model.links, observed.all.iter())
}

/// The Gauss-Newton step x of all unknowns, r ≈ A·x. The first `n_known` unknowns have a prior of standard deviation 1 and already have
/// their most probable values for the present values of the others. There, the gradients of rows and priors cancel, so each prior
/// contributes the row σ·xᵢ = −(Aᵀ·r)ᵢ/σ. With these rows, a few points of many set-ups determine the step too.
fn most_probable_step(
    derivatives: DMatrix<f64>,
    residuals: &DVector<f64>,
    n_known: usize,
    noise_mm: f64,
) -> Option<Vec<f64>> {
    let n_rows = derivatives.nrows();
    let gradient = derivatives.columns(0, n_known).tr_mul(residuals);
    let mut rows = derivatives.resize_vertically(n_rows + n_known, 0.0);
    let mut right = residuals.clone().resize_vertically(n_rows + n_known, 0.0);
    for known in 0..n_known {
        rows[(n_rows + known, known)] = noise_mm;
        right[n_rows + known] = -gradient[known] / noise_mm;
    }
    let (q, r) = rows.qr().unpack();
    let solution = r.solve_upper_triangular(&q.tr_mul(&right))?;
    let is_whole = solution.len() == r.ncols() && solution.iter().all(|x| x.is_finite());
    is_whole.then(|| solution.iter().copied().collect())
}
