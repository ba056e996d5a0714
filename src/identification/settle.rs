//! The last step of least squares: what the data hardly see is drawn towards nominal, as far as noise would move it.
//!
//! With the width S of each link parameter's prior, δ its deviation from nominal and σ² the variance of a coordinate, the most probable answer
//! minimises F + σ²·Σ (δ/S)² (maximum a posteriori; ridge regression [Hoerl & Kennard 1970] with its factor from the data). A combination of
//! singular value s (mm rms per prior) keeps the share N·s²/(N·s² + σ²) of what least squares says: all of it where the data see it well,
//! and everything where they hold no noise. A parameter that comes out several priors away (a joint that was not mastered) gets a prior as
//! wide as that, and is not held back.

use crate::identification::KinematicModel;
use crate::identification::objective::{Observation, weighted_jacobian, weighted_residuals};
use crate::identification::parameters::{Parameter, Quantity, apply, deviation_from};
use crate::identification::prior_fit::Fitting;
use crate::identification::priors::{Priors, Pull};
use crate::identification::search_space::decomposition_at;
use nalgebra::{DMatrix, DVector, Vector3};

/// How far a machined length is off, mm (one standard deviation).
const MACHINED_MM: f64 = 0.5;
/// How far a machined angle between two axes is off, rad (0.05°).
const MACHINED_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// Gauss-Newton steps: the fit is at its minimum already, and the draw moves it by less than a prior.
const STEPS: usize = 4;
/// A deviation of so many priors is no error of a robot fresh from the factory: its prior becomes as wide as it.
const SURPRISING: f64 = 3.0;

/// `model`, the answer of least squares, drawn towards `nominal`. The scales of `fitting` are the parameters' priors where none are stated;
/// those that are stated stay as they are, and what would leave its bounds stays at them.
pub fn settle(
    model: &KinematicModel,
    nominal: &KinematicModel,
    fitting: Fitting<'_>,
    observations: &[Observation],
) -> KinematicModel {
    let Some(priors) = fitting.priors else {
        return settled(model, nominal, fitting, &[], observations);
    };
    let mut held: Vec<usize> = priors
        .at_bounds(model)
        .into_iter()
        .map(|(parameter, _)| parameter)
        .collect();
    let mut model = model.clone();
    loop {
        let settled = settled(&model, nominal, fitting, &held, observations);
        match priors.towards(&model, &settled) {
            (inside, Some(bound)) if !held.contains(&bound) => {
                held.push(bound);
                model = inside;
            }
            (inside, _) => return inside,
        }
    }
}

/// With the parameters that are held where they are.
fn settled(
    model: &KinematicModel,
    nominal: &KinematicModel,
    fitting: Fitting<'_>,
    held: &[usize],
    observations: &[Observation],
) -> KinematicModel {
    let Fitting {
        parameters,
        scale,
        priors,
    } = fitting;
    let counting = observations.iter().filter(|o| o.weight > 0.0).count();
    let scale: Vec<f64> = scale
        .iter()
        .enumerate()
        .map(|(j, s)| if held.contains(&j) { 0.0 } else { *s })
        .collect();
    let stated: Vec<(usize, f64)> = priors
        .map_or(vec![], Priors::stds)
        .into_iter()
        .filter(|(j, _)| !held.contains(j))
        .collect();
    let (directions, _) =
        decomposition_at(model, parameters, &scale, observations).directions_with_priors(&stated);
    let freedom = 3.0 * counting as f64 - directions.ncols() as f64;
    if freedom <= 0.0 || directions.ncols() == 0 {
        return model.clone();
    }
    let cost = weighted_residuals(model, observations).norm_squared();
    let variance = cost / freedom;
    let is_drawn = |j: &usize| {
        parameters[*j].is_link() && scale[*j] > 0.0 && stated.iter().all(|(k, _)| k != j)
    };
    let drawn: Vec<usize> = (0..parameters.len()).filter(is_drawn).collect();
    let from = |mut widths: Vec<f64>| {
        let mut settled = model.clone();
        for _ in 0..STEPS {
            let to_nominal = |j: &usize| Pull {
                parameter: *j,
                weight: variance.sqrt() / widths[*j],
                away: -deviation_from(nominal, &settled, &parameters[*j]),
            };
            let mut pulls: Vec<Pull> = drawn.iter().map(to_nominal).collect();
            pulls.extend(priors.map_or(vec![], |priors| priors.from(&settled).pulls));
            settled = step(&settled, parameters, &pulls, &directions, observations)?;
            widths = prior_widths(&settled, nominal, parameters, &scale);
        }
        let dearest = cost + variance * (SURPRISING * SURPRISING * directions.ncols() as f64);
        (weighted_residuals(&settled, observations).norm_squared() <= dearest).then_some(settled)
    };
    let own = parameters
        .iter()
        .zip(&scale)
        .map(|(p, s)| width(p, *s))
        .collect();
    let settled = from(own).or_else(|| from(prior_widths(model, nominal, parameters, &scale)));
    settled.unwrap_or_else(|| model.clone())
}

/// How far each parameter may be off, mm or rad: its prior, or where it has come out several priors away, as far as it has.
pub fn prior_widths(
    model: &KinematicModel,
    nominal: &KinematicModel,
    parameters: &[Parameter],
    scale: &[f64],
) -> Vec<f64> {
    let of = |(parameter, scale): (&Parameter, &f64)| {
        let prior = width(parameter, *scale);
        let size = if parameter.is_link() {
            deviation_from(nominal, model, parameter).abs()
        } else {
            0.0
        };
        if size > SURPRISING * prior {
            size
        } else {
            prior
        }
    };
    parameters.iter().zip(scale).map(of).collect()
}

/// Links are machined, and their errors small; joint offsets are mastered on the shop floor and keep the scale of the search.
fn width(parameter: &Parameter, scale: f64) -> f64 {
    match parameter {
        Parameter::Link(_, Quantity::A | Quantity::D) => MACHINED_MM,
        Parameter::Link(_, Quantity::Alpha | Quantity::Beta) => MACHINED_RAD,
        _ => scale,
    }
}

/// One Gauss-Newton step of F and the pulls.
fn step(
    model: &KinematicModel,
    parameters: &[Parameter],
    pulls: &[Pull],
    directions: &DMatrix<f64>,
    observations: &[Observation],
) -> Option<KinematicModel> {
    let seen = weighted_jacobian(model, parameters, observations, &Vector3::zeros()) * directions;
    let (n, r) = (seen.nrows(), directions.ncols());
    let mut rows = DMatrix::zeros(n + pulls.len(), r);
    let mut right = DVector::zeros(n + pulls.len());
    rows.rows_mut(0, n).copy_from(&seen);
    right
        .rows_mut(0, n)
        .copy_from(&weighted_residuals(model, observations));
    for (k, pull) in pulls.iter().enumerate() {
        rows.row_mut(n + k)
            .copy_from(&(directions.row(pull.parameter) * pull.weight));
        right[n + k] = pull.weight * pull.away;
    }
    let (q, r) = rows.qr().unpack();
    let z = r.solve_upper_triangular(&q.tr_mul(&right))?;
    let deviation: Vec<f64> = (directions * z).iter().copied().collect();
    deviation
        .iter()
        .all(|v| v.is_finite())
        .then(|| apply(model, parameters, &deviation))
}
