//! Finds a start for least squares if the nominal kinematics are too far off, for example with joints that were never mastered.

use crate::identification::KinematicModel;
use crate::identification::least_squares::estimate::least_squares;
use crate::identification::least_squares::problem::{Problem, reach_mm};
use crate::identification::model::objective::{Observation, residuals};
use crate::identification::model::parameters::{Parameter, Quantity};
use crate::kinematics::Link;
use crate::solvers::median::median;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

/// Least squares has found the robot if half of the points fit to this share of its reach. This is five times the error of real arms, and
/// far below the error of a wrong local minimum of the joint offsets.
const FOUND_PER_REACH: f64 = 1e-3;
/// Half of the residuals are below this multiple of the stated standard deviation of one component. From noise alone, they are below 1.5 times.
pub const STATED_STDS: f64 = 3.0;
/// Maximum number of starts with other joint offsets.
const STARTS: usize = 40;
/// Largest joint offset of a start, rad (90°).
const WIDEST_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Number of concentration steps before a start is given up. Each fits only the best-fitting points, because outliers pull a fit away from the
/// solution of the others [Rousseeuw & Van Driessen 2006, concentration steps].
const CONCENTRATIONS: usize = 3;
/// A concentration step leaves out one of this many points.
const LEFT_OUT: usize = 4;
/// Number of points that starts are compared on, evenly selected.
const COMPARED_POINTS: usize = 60;

/// The start for least squares, with the results of the search.
#[derive(Clone, Debug, PartialEq)]
pub struct BestStart {
    /// The start: nominal, or the end of the best of several searches.
    pub model: KinematicModel,
    /// Median residual at the end of least squares from nominal, mm. If the fit to all points is poor, the worst-fitting points are left out.
    pub from_nominal_mm: f64,
    /// True if the worst-fitting points had to be left out: outliers may have pulled least squares away from the solution.
    pub needed_trimming: bool,
    /// Median residual at the end of least squares from the network's stored answer, mm; `None` if nominal was good enough.
    pub from_remembered_mm: Option<f64>,
    /// Median residual at the best end, mm.
    pub best_mm: f64,
    /// Starts with other offsets that were tried.
    pub n_starts: usize,
    /// Largest median residual that counts as a fit, mm.
    pub found_mm: f64,
}

/// Runs least squares from nominal. If the result is far from the points, even from those that fit best, least squares runs from the stored
/// answer and then from random joint offsets of up to 90°, until a result fits. Each of these starts is first `placed` on the points.
/// `stated_std_mm` is the stated noise of one coordinate, 0 if none is stated.
pub fn best_start(
    nominal: &KinematicModel,
    remembered: Option<&KinematicModel>,
    parameters: &[Parameter],
    observations: &[Observation],
    stated_std_mm: f64,
    placed: &dyn Fn(Vec<Link>, &[Observation]) -> KinematicModel,
) -> BestStart {
    let compared = evenly_taken(observations, nominal.targets_mm.len());
    let compared = if 3 * compared.len() < 2 * parameters.len() {
        observations.to_vec()
    } else {
        compared
    };
    let found_mm = f64::max(
        FOUND_PER_REACH * reach_mm(&nominal.links, compared.iter()),
        STATED_STDS * stated_std_mm,
    );
    let fitted = |start: &KinematicModel, points: &[Observation]| {
        let problem = Problem::new(nominal.clone(), parameters, points);
        least_squares(&problem, start)
    };
    let end = |start: &KinematicModel| {
        let model = fitted(start, &compared);
        (median_mm(&model, &compared), model)
    };
    // The solution without the influence of a few bad points.
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
    let needed_trimming = from_nominal_mm > found_mm;
    if needed_trimming {
        (from_nominal_mm, best) = concentrated(from_nominal_mm, best);
    }
    let mut found = BestStart {
        model: nominal.clone(),
        from_nominal_mm,
        needed_trimming,
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
    // Without a free offset, all starts are the same.
    let n_starts = if parameters.iter().any(is_offset) {
        STARTS
    } else {
        0
    };
    while found.best_mm > found_mm && found.n_starts < n_starts {
        found.n_starts += 1;
        // Starts with small offsets, because most joints are off by little.
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
    if needed_trimming {
        found.model = best;
    }
    found
}

/// Points with nonzero weight, evenly selected from each target, so that every target has its share whatever the order in the file.
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

/// The best-fitting points. One of every `left_out` points is left out, those that fit worst.
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
    median(residuals(model, observations).iter().map(Vector3::norm)).unwrap_or(0.0)
}
