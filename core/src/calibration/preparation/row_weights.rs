//! Weights of positions and rotations of poses, and of positions whose noise differs between directions. The variance of each is estimated.
//!
//! The variance of a row is the instrument's stated variance plus an excess of the robot. The excess is estimated separately for positions and for
//! rotations. After a fit, the normalised squares of a class sum to its number of rows minus its leverages. Fit and weights alternate until neither
//! changes [Förstner 1979; Paule & Mandel 1982]. A stated noise is thus a lower bound: a T-Mac states 0.01 mm where the links miss by 0.45 mm.
//!
//! The excess is the same in all directions. An instrument that states a covariance C of a position thus has C + s²·1. A distance that is ten times
//! more accurate than the angles has ten times the influence only if the robot is as accurate.

use crate::calibration::Error;
use crate::calibration::preparation::motions::fit_motions;
use crate::calibration::preparation::observe::{Observed, placed, relative_weights, to_base};
use crate::calibration::problem::Problem;
use crate::calibration::request::{CalibrationRequest, Method, Preset};
use crate::identification::least_squares::estimate::{Estimate, estimate};
use crate::identification::least_squares::linearisation::decomposition_at;
use crate::identification::least_squares::multistart::{BestStart, best_start};
use crate::identification::least_squares::problem::{self, USUAL_ANGLE_RAD, usual_length_mm};
use crate::identification::model::objective::{Observation, with_weight};
use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::variance::{
    probable_variance_over_usual, variance_over_usual,
};
use crate::measurement::position_noise::PositionNoise;
use crate::measurement::{MeasurementSet, Point, Subset};
use crate::solvers::watch::Watch;
use nalgebra::{DMatrix, IsometryMatrix3};
use std::ops::ControlFlow;

/// Maximum number of rounds of fit and weights; three to five are usual.
const ROUNDS: usize = 12;
/// The rounds end when both standard deviations change by less than this share.
const CONVERGED: f64 = 1e-3;
/// The ratio of both standard deviations may differ from the usual ratio by this factor at most.
const MAX_RATIO_FACTOR: f64 = 100.0;

/// Excess scatter of rows beyond the instrument's stated noise, one standard deviation of a coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Noise {
    position_mm: f64,
    rotation_rad: f64,
}

/// Points that were fitted, and the noise that their weights were computed from.
struct Weighed<'a> {
    points: &'a [Observation],
    noise: &'a Noise,
    is_by_direction: bool,
}

/// Rows that share a variance. For each residual of three rows: its squared length and the stated variance of a row. If directions differ: the square
/// and the stated variance of each row.
#[derive(Default)]
struct Class {
    squares: Vec<(f64, f64)>,
    freedom: f64,
}

/// Stated noise of a point, one standard deviation of a coordinate, mm and rad; 0 if nothing is stated.
fn stated(point: &Point) -> (f64, f64) {
    let position_mm = point.position_std_mm().unwrap_or(0.0);
    (position_mm, point.std_rotation_rad.unwrap_or(0.0))
}

/// Start model from the positions of the poses alone; they show whether joints are far off.
pub fn start_of_poses(problem: &Problem<'_>) -> BestStart {
    let n_targets = problem.screening.targets.len();
    let placed = |links, points: &[Observation]| placed(problem.request, links, points, n_targets);
    let positions = problem.identify.iter().map(Observation::position_alone);
    let positions: Vec<Observation> = positions.collect();
    let is_of_position = |p: &&Parameter| !matches!(p, Parameter::TargetRotation(..));
    let parameters = problem.parameters.iter().filter(is_of_position);
    let parameters: Vec<Parameter> = parameters.copied().collect();
    best_start(
        &problem.nominal,
        None,
        &parameters,
        &positions,
        problem.request.stated_position_std_mm(),
        &placed,
    )
}

/// True if the noise of a set's positions is weighed by direction. The swarms and the paper's preset have one weight per point.
pub fn is_by_direction(request: &CalibrationRequest, set: &MeasurementSet) -> bool {
    let is_least_squares = matches!(request.method, Method::Auto | Method::LeastSquares);
    request.preset == Preset::Default && is_least_squares && set.has_uneven_noise()
}

/// The noise of a point, if it differs between directions.
pub(super) fn uneven_noise(point: &Point) -> Option<&PositionNoise> {
    point
        .position_noise
        .as_ref()
        .filter(|noise| !noise.is_isotropic())
}

/// Weighs the points of a problem, including those to verify, and recomputes the decomposition. Does nothing for positions without poses and without
/// direction-dependent noise.
///
/// # Errors
/// As [`fit_motions`].
pub fn weigh(problem: &mut Problem<'_>, watch: &Watch<'_>) -> Result<(), Error> {
    let (request, has_poses) = (problem.request, problem.request.set.has_poses());
    let is_by_direction = is_by_direction(request, &request.set);
    if !has_poses && !is_by_direction {
        return Ok(());
    }
    let n_targets = problem.screening.targets.len();
    let start = start_of_poses(problem).model;
    let mut model = match start == problem.nominal {
        true => start,
        false => placed(problem.request, start.links, &problem.identify, n_targets),
    };
    let reach_mm = problem::reach_mm(&problem.nominal.links, problem.identify.iter());
    let mut noise = Noise {
        position_mm: usual_length_mm(reach_mm),
        rotation_rad: USUAL_ANGLE_RAD,
    };
    for _ in 0..ROUNDS {
        apply(problem, &noise, is_by_direction);
        // With a robust loss, gross errors remain in the fit. The noise is estimated from the other points.
        let points = problem.trusted();
        let rows = problem.rows(&points, &[]);
        let go_on = &mut |_| match watch.goes_on() {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        };
        let found = estimate(&rows, &rows.coordinates(&model), 0.0, go_on);
        if watch.was_stopped() {
            return Ok(());
        }
        let weighed = Weighed {
            points: &points,
            noise: &noise,
            is_by_direction,
        };
        let next = estimated(problem, &rows, &found, &weighed, reach_mm);
        let near = |a: f64, b: f64| (a - b).abs() <= CONVERGED * b;
        let is_found = near(next.position_mm, noise.position_mm)
            && near(next.rotation_rad, noise.rotation_rad);
        (noise, model) = (next, found.model);
        if is_found {
            break;
        }
    }
    apply(problem, &noise, is_by_direction);
    if has_poses && problem.arrangement.motions.len() > 1 {
        let (observed, arrangement) = (&mut problem.observed, &mut problem.arrangement);
        fit_motions(
            request,
            observed,
            arrangement,
            Some(Subset::Identify),
            watch,
        )?;
        problem.arrangement.apply(&mut problem.observed);
        problem.identify = problem.observed.of(Subset::Identify);
    }
    // The nominal robot ("before") is placed with the same weights as the identified robot.
    let links = problem.nominal.links.clone();
    let with_weight = with_weight(&problem.identify);
    problem.nominal = placed(problem.request, links, &with_weight, n_targets);
    problem.decomposition = decomposition_at(
        &problem.nominal,
        &problem.parameters,
        &problem.decomposition.scale,
        &problem.identify,
    );
    Ok(())
}

/// Variance of a coordinate of a point's position and rotation, mm² and rad².
fn variances(point: &Point, noise: &Noise) -> (f64, f64) {
    let (position_mm, rotation_rad) = stated(point);
    (
        position_mm * position_mm + noise.position_mm * noise.position_mm,
        rotation_rad * rotation_rad + noise.rotation_rad * noise.rotation_rad,
    )
}

/// Sets the weights to the inverse variances, scaled to mean 1 over the identify points. A weight of 0 stays 0.
fn apply(problem: &mut Problem<'_>, noise: &Noise, is_by_direction: bool) {
    let set = &problem.request.set;
    let all = &mut problem.observed.all;
    let is_fitted =
        |row: &usize| problem.observed.subsets[*row] == Subset::Identify && all[*row].weight > 0.0;
    let fitted: Vec<usize> = (0..all.len()).filter(is_fitted).collect();
    let precision = |point: &Point| 1.0 / variances(point, noise).0;
    let precisions: Vec<f64> = set.points.iter().map(precision).collect();
    let weights = relative_weights(&precisions, |row| is_fitted(&row));
    for ((point, o), weight) in set.points.iter().zip(all.iter_mut()).zip(weights) {
        let (position_mm2, rotation_rad2) = variances(point, noise);
        if o.weight > 0.0 {
            o.weight = weight;
        }
        if let Some(rotation) = &mut o.rotation {
            rotation.mm_per_rad = (position_mm2 / rotation_rad2).sqrt();
        }
    }
    if is_by_direction {
        let to_measuring = to_base(problem.request).inverse();
        let motion_of = |row: usize| problem.arrangement.motions[problem.arrangement.setups[row]];
        let beside_mm = noise.position_mm;
        whiten(
            &mut problem.observed,
            set,
            beside_mm,
            &to_measuring,
            &motion_of,
        );
    }
    problem.identify = problem.observed.of(Subset::Identify);
    let least = [least_sigma_mm(set, &fitted), set.rounding_std_mm()];
    problem.least_sigma_mm = least.into_iter().flatten().reduce(f64::max);
}

/// Whitens each point's stated noise plus an isotropic part `beside_mm`. The noise is stated in the measuring frame. `to_measuring`
/// transforms from the frame of the observations to the measuring frame. The motion of a row transforms its observation into the frame of
/// the fit.
pub(super) fn whiten(
    observed: &mut Observed,
    set: &MeasurementSet,
    beside_mm: f64,
    to_measuring: &IsometryMatrix3<f64>,
    motion_of: &dyn Fn(usize) -> IsometryMatrix3<f64>,
) {
    for (row, point) in set.points.iter().enumerate() {
        let whitening = uneven_noise(point)
            .map(|noise| noise.whitening(beside_mm) * to_measuring.rotation.matrix());
        observed.whitenings[row] = whitening;
        observed.all[row].whitening =
            whitening.map(|w| w * motion_of(row).rotation.matrix().transpose());
    }
}

/// Stated noise of the fitted points: standard deviation of a row of weight 1, mm. `None` if one of them states nothing.
fn least_sigma_mm(set: &MeasurementSet, fitted: &[usize]) -> Option<f64> {
    let stated = fitted.iter().map(|row| stated(&set.points[*row]).0);
    let precisions: f64 = stated.map(|std| 1.0 / (std * std)).sum();
    let std_mm = (fitted.len() as f64 / precisions).sqrt();
    (std_mm.is_finite() && std_mm > 0.0).then_some(std_mm)
}

/// Estimates the excess scatter of the rows after a fit.
fn estimated(
    problem: &Problem<'_>,
    rows: &problem::Problem<'_>,
    found: &Estimate,
    weighed: &Weighed<'_>,
    reach_mm: f64,
) -> Noise {
    let [position, rotation] = classes(problem, rows, found, weighed);
    let (length_mm, angle_rad) = (usual_length_mm(reach_mm), USUAL_ANGLE_RAD);
    let usual = |class: &Class, usual: f64| -> Vec<(f64, f64, f64)> {
        let terms = class.squares.iter();
        terms
            .map(|(square, stated)| (*square, *stated, usual * usual))
            .collect()
    };
    let factor = match problem.request.set.has_poses() {
        true => probable_variance_over_usual,
        false => variance_over_usual,
    };
    let of = |class: &Class, usual_std: f64| factor(&usual(class, usual_std), class.freedom).sqrt();
    let (position, rotation) = (of(&position, length_mm), of(&rotation, angle_rad));
    Noise {
        position_mm: position * length_mm,
        rotation_rad: rotation.clamp(position / MAX_RATIO_FACTOR, position * MAX_RATIO_FACTOR)
            * angle_rad,
    }
}

/// Squared residuals of positions and of rotations, and the redundancy of each class.
fn classes(
    problem: &Problem<'_>,
    rows: &problem::Problem<'_>,
    found: &Estimate,
    weighed: &Weighed<'_>,
) -> [Class; 2] {
    let (n_rows, p) = (rows.n_rows(), found.x.len());
    let (mut residuals, mut jacobian) = (vec![0.0; n_rows], DMatrix::zeros(n_rows, p));
    rows.evaluate(&found.x, &mut residuals, Some(&mut jacobian));
    let sigma_mm = found.evidence.sigma_mm;
    let taken = jacobian * (&found.posterior.root / sigma_mm);
    let to_identify = problem
        .observed
        .subsets
        .iter()
        .zip(&problem.request.set.points);
    let points = to_identify
        .filter(|(subset, _)| **subset == Subset::Identify)
        .map(|(_, point)| point);
    let mut classes = [Class::default(), Class::default()];
    let mut row = 0;
    let with_weight = weighed
        .points
        .iter()
        .zip(points)
        .filter(|(o, _)| o.weight > 0.0);
    for (o, point) in with_weight {
        let (position_mm, rotation_rad) = stated(point);
        let uneven = uneven_noise(point).filter(|_| weighed.is_by_direction);
        let mut add = |class: usize, root: f64, stated: f64, uneven: Option<&PositionNoise>| {
            let here = row..row + 3;
            let leverage = taken.rows(row, 3).norm_squared();
            let class: &mut Class = &mut classes[class];
            match uneven {
                None => {
                    let square: f64 = residuals[here].iter().map(|r| r * r).sum();
                    let term = (square / (root * root), stated * stated);
                    class.squares.push(term);
                }
                Some(noise) => {
                    let whitening_scales = noise.whitening_scales(weighed.noise.position_mm);
                    class.squares.extend((0..3).map(|axis| {
                        let along_mm = residuals[row + axis] / (root * whitening_scales[axis]);
                        let std_mm = noise.std_mm[axis];
                        (along_mm * along_mm, std_mm * std_mm)
                    }));
                }
            }
            class.freedom += 3.0 - leverage;
            row += 3;
        };
        add(0, o.weight.sqrt(), position_mm, uneven);
        if let Some(measured) = &o.rotation {
            let root = o.weight.sqrt() * measured.mm_per_rad;
            add(1, root, rotation_rad, None);
        }
    }
    classes
}
