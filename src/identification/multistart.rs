//! A start for least squares where nominal kinematics are too far off: joints that were never mastered.

use crate::identification::KinematicModel;
use crate::identification::estimate::least_squares;
use crate::identification::objective::{Observation, residuals};
use crate::identification::parameters::{Parameter, Quantity};
use crate::identification::problem::{Problem, reach_mm};
use crate::kinematics::Link;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Least squares has found the robot if half of the points fit to this share of its reach: five times what real arms leave, and far below
/// what another valley of joint offsets does.
const FOUND_PER_REACH: f64 = 1e-3;
/// Starts with other joint offsets at most.
const STARTS: usize = 40;
/// Offsets of a start are drawn up to this to both sides, rad (90°).
const WIDEST_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Before a start is left, the part of the points that fit best is fitted alone, so often: outliers pull a fit away from where the
/// others would hold it [Rousseeuw & Van Driessen 2006, concentration steps].
const CONCENTRATIONS: usize = 3;
/// The points that a concentration leaves out: one of so many.
const LEFT_OUT: usize = 4;
/// Points that starts are compared on, evenly taken from all.
const COMPARED_POINTS: usize = 60;

/// Where least squares should begin, and what that rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct BestStart {
    /// The start: nominal, or the end of the best of several searches.
    pub model: KinematicModel,
    /// Median residual where least squares from nominal ended, mm, the points that fit worst left out where all of them are no fit.
    pub from_nominal_mm: f64,
    /// Whether it took leaving out the points that fit worst: outliers pull least squares away from where it should end.
    pub is_pulled_away: bool,
    /// Median residual where least squares from what is remembered of the robot ended, mm; none if nominal was near enough.
    pub from_remembered_mm: Option<f64>,
    /// Median residual at the best end, mm.
    pub best_mm: f64,
    /// Starts with other offsets that were tried.
    pub n_starts: usize,
    /// A median residual up to this is a fit, mm.
    pub found_mm: f64,
}

/// Runs least squares from nominal; if it ends far from the points, even from those that fit best, then from what is remembered of the robot,
/// then from random joint offsets of up to 90°, each `placed` anew on the points, until one of them fits.
pub fn best_start(
    nominal: &KinematicModel,
    remembered: Option<&KinematicModel>,
    parameters: &[Parameter],
    observations: &[Observation],
    placed: &dyn Fn(Vec<Link>, &[Observation]) -> KinematicModel,
) -> BestStart {
    let compared = evenly_taken(observations, nominal.targets_mm.len());
    let compared = if 3 * compared.len() < 2 * parameters.len() {
        observations.to_vec()
    } else {
        compared
    };
    let found_mm = FOUND_PER_REACH * reach_mm(&nominal.links, compared.iter());
    let fitted = |start: &KinematicModel, points: &[Observation]| {
        let problem = Problem::new(nominal.clone(), parameters, points);
        least_squares(&problem, start)
    };
    let end = |start: &KinematicModel| {
        let model = fitted(start, &compared);
        (median_mm(&model, &compared), model)
    };
    // where the robot should be, whatever a few points say
    let concentrated = |mut median: f64, mut model: KinematicModel| {
        for _ in 0..CONCENTRATIONS {
            if median <= found_mm {
                break;
            }
            let core = best_fitting(&model, &compared, LEFT_OUT);
            model = fitted(&model, &core);
            median = median_mm(&model, &compared);
        }
        (median, model)
    };
    let (mut from_nominal_mm, mut best) = end(nominal);
    let is_pulled_away = from_nominal_mm > found_mm;
    if is_pulled_away {
        (from_nominal_mm, best) = concentrated(from_nominal_mm, best);
    }
    let mut found = BestStart {
        model: nominal.clone(),
        from_nominal_mm,
        is_pulled_away,
        from_remembered_mm: None,
        best_mm: from_nominal_mm,
        n_starts: 0,
        found_mm,
    };
    if let Some(start) = remembered.filter(|_| from_nominal_mm > found_mm) {
        let (median, model) = end(start);
        let (median, model) = concentrated(median, model);
        found.from_remembered_mm = Some(median);
        if median < found.best_mm {
            (found.best_mm, best) = (median, model);
        }
    }
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let is_offset = |p: &Parameter| matches!(p, Parameter::Link(_, Quantity::ThetaOffset));
    // without a free offset every start is the same
    let n_starts = if parameters.iter().any(is_offset) {
        STARTS
    } else {
        0
    };
    while found.best_mm > found_mm && found.n_starts < n_starts {
        found.n_starts += 1;
        // narrow first: most joints are off by little
        let widest = WIDEST_RAD * found.n_starts as f64 / STARTS as f64;
        let mut links = nominal.links.clone();
        for parameter in parameters {
            if let Parameter::Link(link, Quantity::ThetaOffset) = parameter {
                links[*link].theta_offset_rad += widest * (2.0 * random.random::<f64>() - 1.0);
            }
        }
        let (median, model) = end(&placed(links, &compared));
        if median < found.best_mm {
            (found.best_mm, best) = (median, model);
        }
    }
    if is_pulled_away {
        found.model = best;
    }
    found
}

/// Some of the points that count, evenly from those of each target: however targets alternate in a file, each has its share.
fn evenly_taken(observations: &[Observation], n_targets: usize) -> Vec<Observation> {
    let every = observations.len().div_ceil(COMPARED_POINTS).max(1);
    let of_target = |target| {
        observations
            .iter()
            .filter(move |o| o.target == target && o.weight > 0.0)
            .step_by(every)
    };
    (0..n_targets).flat_map(of_target).cloned().collect()
}

/// Points that fit best; of `left_out` points, the one that fits worst is left out.
pub fn best_fitting(
    model: &KinematicModel,
    observations: &[Observation],
    left_out: usize,
) -> Vec<Observation> {
    let mut by_length: Vec<(f64, usize)> = residuals(model, observations)
        .iter()
        .map(Vector3::norm)
        .zip(0..)
        .collect();
    by_length.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    by_length.truncate(observations.len() - observations.len() / left_out);
    by_length
        .into_iter()
        .map(|(_, i)| observations[i].clone())
        .collect()
}

/// Median length of the residuals, mm; 0 without points.
pub fn median_mm(model: &KinematicModel, observations: &[Observation]) -> f64 {
    let mut lengths: Vec<f64> = residuals(model, observations)
        .iter()
        .map(Vector3::norm)
        .collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get(lengths.len() / 2).copied().unwrap_or(0.0)
}
