//! Tests whether a few poses still fit an earlier estimate, and which changes the poses can detect.
//!
//! The model is `r = J·δ + Φ·u + B·b + E·c + e`, 3·N rows in mm, measured − predicted by the earlier estimate:
//!
//! - δ and u: errors of the earlier parameters, and effects that links cannot describe. The root of their mean square error is stored with
//!   the estimate; D is the effect of its columns on these points;
//! - b: base and targets, without prior knowledge, if they are fitted anew;
//! - e: white noise of a coordinate, which is the larger of two: the earlier session's noise, and the instrument's stated noise of the point.
//!   Also the errors that points of one configuration share, as in the earlier session. Points of one configuration are never treated as
//!   independent;
//! - c: a change since then. An unchanged robot has c = 0.
//!
//! With V = D·Dᵀ + noise = L·Lᵀ and Q the orthonormal columns that span L⁻¹·B, z = (I − Q·Qᵀ)·L⁻¹·r has m = 3·N − rank Q dimensions. |z|²/m is
//! compared with Fisher's F of m and ν degrees of freedom, where ν belongs to the earlier session's noise. A change c shifts z by (I − Q·Qᵀ)·L⁻¹·E·c.
//! The test has the stated power if the square of that shift is the noncentrality at which F has this power.

use crate::identification::KinematicModel;
use crate::identification::model::objective::{
    Observation, posed_targets, residuals, weighted_jacobian,
};
use crate::identification::model::parameters::{
    Parameter, Quantity, placement_parameters, target_rotation_parameters,
};
use crate::identification::statistics::changes::{FALSE_ALARMS, usual_error};
pub use crate::identification::statistics::difference::Causes;
use crate::identification::statistics::difference::{Whitened, causes};
use crate::identification::statistics::distributions::{f_tail, noncentrality};
use crate::identification::statistics::estimate::Estimate;
use crate::solvers::orthonormal::span;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Significance level: share of unchanged robots that the test calls changed.
pub const LEVEL: f64 = FALSE_ALARMS;
/// Power: probability with which a change of the stated size is detected.
pub const POWER: f64 = 0.95;
/// Minimum noise as a share of the reach: neither robots nor trackers repeat a pose better.
const MIN_NOISE_PER_REACH: f64 = 1e-5;
/// A configuration with more than this share of the statistic stands out: a broken beam may be the cause.
const OUTSTANDING_SHARE: f64 = 0.5;
/// Minimum share of an effect that the placement must leave; less is rounding. For causes it is a share of the largest effect of a usual error.
const MIN_VISIBLE_SHARE: f64 = 1e-6;
/// Largest detectable rotation of a zero, rad. If the necessary rotation is larger, the reflector is so near the joint's axis that the
/// linearisation is invalid.
const MAX_TURN_RAD: f64 = 0.1;
/// Minimum degrees of freedom of the earlier noise for a decision.
const MIN_FREEDOM: f64 = 5.0;
/// Iteration limit of a decomposition.
const SVD_ITERATIONS: usize = 10_000;

/// A few measured points with the earlier estimate.
#[derive(Clone, Copy, Debug)]
pub struct Poses<'a> {
    /// The earlier estimate.
    pub before: &'a Estimate,
    /// The links of the estimate, with its base and targets or with those that were fitted anew.
    pub model: &'a KinematicModel,
    /// The points, with targets numbered as in `model`. They have rotations only if these are needed for the position at a lever.
    pub observations: &'a [Observation],
    /// Configuration number of each point.
    pub configurations: &'a [usize],
    /// Stated noise of a coordinate of each point, mm; 0 if nothing is stated.
    pub stated_std_mm: &'a [f64],
    /// True if base and targets are fitted anew.
    pub is_placed_anew: bool,
}

/// The smallest change of one kind that the test detects with probability [`POWER`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detectable {
    /// The change, mm or rad. `None` if these poses do not show it: the placement absorbs it, or the reflector is almost on the joint's
    /// axis.
    pub change: Option<f64>,
    /// Displacement of the target by that change, rms over these points, mm.
    pub tool_mm: Option<f64>,
    /// If these poses do not show the change: displacement of the target by a rotation of [`MAX_TURN_RAD`], rms over these points, mm; 0 for shifts.
    pub unseen_tool_mm: f64,
}

/// The test, and the smallest changes that it can detect.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// |z|².
    pub statistic: f64,
    /// m: number of equations minus the number of placement parameters.
    pub n_combinations: usize,
    /// ν.
    pub freedom: f64,
    /// Probability that an unchanged robot gives at least this statistic.
    pub probability: f64,
    /// Expected 3-D error of a point from the earlier estimate and its noise, rms, mm.
    pub expected_mm: f64,
    /// Smallest detectable change of each joint's zero.
    pub joints: Vec<Detectable>,
    /// Smallest detectable shift of the base, in the least visible direction.
    pub base: Detectable,
    /// Smallest detectable shift of each target, in the least visible direction.
    pub targets: Vec<Detectable>,
    /// Index of the configuration that alone has more than half of the statistic, if there is one.
    pub largest_configuration: Option<usize>,
    whitened: Whitened,
}

/// Why there is no test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Untestable {
    /// Base and targets absorb every equation.
    NothingLeft,
    /// The earlier session does not determine its own noise well enough.
    NoiseUnknown,
    /// The covariance is singular.
    Singular,
}

/// Tests the points.
///
/// # Errors
/// [`Untestable`].
pub fn quick_check(poses: &Poses<'_>) -> Result<Checked, Untestable> {
    let Poses {
        model,
        observations,
        ..
    } = *poses;
    let freedom = poses.before.uncertainty.freedom;
    if freedom < MIN_FREEDOM {
        return Err(Untestable::NoiseUnknown);
    }
    let covariance = covariance_mm2(poses);
    let root = covariance.clone().cholesky().ok_or(Untestable::Singular)?;
    let whiten = |m: DMatrix<f64>| {
        root.l()
            .solve_lower_triangular(&m)
            .ok_or(Untestable::Singular)
    };
    let mut placement = placement_parameters(model.targets_mm.len());
    placement.extend(target_rotation_parameters(&posed_targets(observations)));
    let placed = whiten(jacobian(poses, &placement))?;
    let taken = match poses.is_placed_anew {
        true => span(&placed).ok_or(Untestable::Singular)?,
        false => DMatrix::zeros(3 * observations.len(), 0),
    };
    let left = |m: &DMatrix<f64>| m - &taken * taken.tr_mul(m);
    let n_combinations = (3 * observations.len()).saturating_sub(taken.ncols());
    if n_combinations == 0 {
        return Err(Untestable::NothingLeft);
    }
    let rows: Vec<f64> = residuals(model, observations)
        .iter()
        .flat_map(|r| [r.x, r.y, r.z])
        .collect();
    let z = left(&whiten(DMatrix::from_vec(rows.len(), 1, rows))?);
    let statistic = z.norm_squared();
    let m = n_combinations as f64;
    let shift = noncentrality(LEVEL, POWER, m, freedom).sqrt();
    let detectable = |parameters: &[Parameter], most: f64| -> Result<Detectable, Untestable> {
        let raw = jacobian(poses, parameters);
        let whole = whiten(raw.clone())?;
        Ok(smallest(&raw, &whole, &left(&whole), (shift, most)))
    };
    let zero = |link: usize| [Parameter::Link(link, Quantity::ThetaOffset)];
    let target = |t: usize| [0, 1, 2].map(|axis| Parameter::Target(t, axis));
    let parameters = candidates(poses, &placement);
    let reach_mm = model.reach_mm();
    let scale: Vec<f64> = parameters
        .iter()
        .map(|p| usual_error(*p, reach_mm))
        .collect();
    let mut effects = left(&whiten(jacobian(poses, &parameters))?);
    for (mut column, scale) in effects.column_iter_mut().zip(&scale) {
        column *= *scale;
    }
    Ok(Checked {
        statistic,
        n_combinations,
        freedom,
        probability: f_tail(statistic / m, m, freedom),
        expected_mm: (covariance.trace() / observations.len() as f64).sqrt(),
        joints: (0..model.links.len())
            .map(|link| detectable(&zero(link), MAX_TURN_RAD))
            .collect::<Result<_, _>>()?,
        base: detectable(&placement[..3], f64::INFINITY)?,
        targets: (0..model.targets_mm.len())
            .map(|t| detectable(&target(t), f64::INFINITY))
            .collect::<Result<_, _>>()?,
        largest_configuration: outstanding(&z, poses.configurations),
        whitened: Whitened {
            difference: z.column(0).into(),
            parameters,
            effects,
            scale,
            n_combinations,
            freedom,
        },
    })
}

impl Checked {
    /// The causes of the difference, among the parameters for which `belongs` returns true.
    pub fn causes(&self, belongs: impl Fn(&Parameter) -> bool) -> Causes {
        let all = &self.whitened;
        let effect = |k: usize| all.effects.column(k).norm();
        let largest = (0..all.parameters.len()).map(effect).fold(0.0, f64::max);
        // Effects that the placement absorbs leave only rounding, which explains nothing.
        let is_seen = |k: usize| effect(k) > MIN_VISIBLE_SHARE * largest;
        let chosen: Vec<usize> = (0..all.parameters.len())
            .filter(|k| belongs(&all.parameters[*k]) && is_seen(*k))
            .collect();
        causes(&all.with_parameters(&chosen))
    }
}

/// Parameters of the links; also those of base and targets, unless they are fitted anew.
fn candidates(poses: &Poses<'_>, placement: &[Parameter]) -> Vec<Parameter> {
    let quantities = [
        Quantity::ThetaOffset,
        Quantity::A,
        Quantity::Alpha,
        Quantity::D,
        Quantity::Beta,
    ];
    let of_links = quantities.into_iter().flat_map(|quantity| {
        (0..poses.model.links.len()).map(move |link| Parameter::Link(link, quantity))
    });
    let placement = match poses.is_placed_anew {
        true => [].iter(),
        false => placement.iter(),
    };
    of_links.chain(placement.copied()).collect()
}

/// ∂(predicted position)/∂(parameter), 3·N × p, mm per mm or rad: for a pose, the first three of its rows.
fn jacobian(poses: &Poses<'_>, parameters: &[Parameter]) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(3 * poses.observations.len(), parameters.len());
    for (i, o) in poses.observations.iter().enumerate() {
        let unweighted = [Observation {
            weight: 1.0,
            ..o.with_even_noise()
        }];
        let of_point = weighted_jacobian(poses.model, parameters, &unweighted, &Vector3::zeros());
        all.rows_mut(3 * i, 3).copy_from(&of_point.rows(0, 3));
    }
    all
}

/// V, 3·N × 3·N, mm².
fn covariance_mm2(poses: &Poses<'_>) -> DMatrix<f64> {
    let Poses {
        before,
        model,
        observations,
        ..
    } = *poses;
    let known = &before.uncertainty;
    let p = known.n_parameters;
    // Base and targets that are fitted anew differ from those of the earlier session.
    let counts = |parameter: &Parameter| !poses.is_placed_anew || parameter.is_link();
    let rows: Vec<usize> = (0..p).filter(|j| counts(&before.parameters[*j])).collect();
    let parameters: Vec<Parameter> = rows.iter().map(|j| before.parameters[*j]).collect();
    let mut errors = jacobian(poses, &parameters) * known.root.select_rows(&rows);
    if known.root.nrows() > p {
        let here = observations
            .iter()
            .map(|o| (o.q_rad.as_slice(), o.target, 1.0));
        let mut features = known.features.features(model, here);
        for (i, o) in observations.iter().enumerate() {
            let unweighted = Observation {
                weight: 1.0,
                ..o.with_even_noise()
            };
            if let Some(coupling) = unweighted.coupling() {
                let mut rows = features.rows_mut(3 * i, 3);
                rows += coupling * known.features.turns(model, &unweighted);
            }
        }
        errors += features * known.root.rows(p, known.root.nrows() - p);
    }
    let mut covariance = &errors * errors.transpose();
    let finest_mm = MIN_NOISE_PER_REACH * model.reach_mm() / 3.0_f64.sqrt();
    let shared_mm2 = known.configuration_std_mm * known.configuration_std_mm;
    for (i, configuration) in poses.configurations.iter().enumerate() {
        let std_mm = known
            .noise_std_mm
            .max(poses.stated_std_mm[i])
            .max(finest_mm);
        for axis in 0..3 {
            covariance[(3 * i + axis, 3 * i + axis)] += std_mm * std_mm;
            for (j, other) in poses.configurations.iter().enumerate() {
                if configuration == other {
                    covariance[(3 * i + axis, 3 * j + axis)] += shared_mm2;
                }
            }
        }
    }
    covariance
}

/// The change in the least visible direction that shifts the rows by `shift`. `raw` is the effect of a unit of each parameter on the points, mm;
/// `whole` is the same whitened, and `left` is the part that the placement leaves. A change above `most` does not count as detectable.
fn smallest(
    raw: &DMatrix<f64>,
    whole: &DMatrix<f64>,
    left: &DMatrix<f64>,
    (shift, most): (f64, f64),
) -> Detectable {
    let n_points = raw.nrows() as f64 / 3.0;
    let unseen = Detectable {
        change: None,
        tool_mm: None,
        unseen_tool_mm: match most.is_finite() {
            true => raw.norm() * most / n_points.sqrt(),
            false => 0.0,
        },
    };
    let direction = match raw.ncols() {
        1 => DVector::from_element(1, 1.0),
        _ => {
            let square: Matrix3<f64> = left.tr_mul(left).fixed_view::<3, 3>(0, 0).into();
            let Some(eigen) = square.try_symmetric_eigen(f64::EPSILON, SVD_ITERATIONS) else {
                return unseen;
            };
            let least = eigen.eigenvalues.imin();
            DVector::from_column_slice(eigen.eigenvectors.column(least).as_slice())
        }
    };
    let (seen, all) = ((left * &direction).norm(), (whole * &direction).norm());
    if seen <= MIN_VISIBLE_SHARE * all {
        return unseen;
    }
    let change = shift / seen;
    if change > most {
        return unseen;
    }
    Detectable {
        change: Some(change),
        tool_mm: Some((raw * &direction).norm() * change / n_points.sqrt()),
        unseen_tool_mm: 0.0,
    }
}

/// The configuration that has more than [`OUTSTANDING_SHARE`] of the statistic.
fn outstanding(z: &DMatrix<f64>, configurations: &[usize]) -> Option<usize> {
    let n = configurations.iter().map(|c| c + 1).max().unwrap_or(0);
    let mut of_each = vec![0.0; n];
    for (i, configuration) in configurations.iter().enumerate() {
        of_each[*configuration] += z.rows(3 * i, 3).norm_squared();
    }
    of_each
        .iter()
        .position(|part| *part > OUTSTANDING_SHARE * z.norm_squared())
}
