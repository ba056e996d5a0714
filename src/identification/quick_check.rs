//! Whether a few poses still fit an earlier estimate, and which change they could have seen.
//!
//! `r = J·δ + Φ·u + B·b + E·c + e`, 3·N rows in mm, measured − predicted by the earlier estimate:
//!
//! - δ and u, errors of the earlier parameters and what links cannot say: the root of their mean square error was kept with the estimate, D is what
//!   its columns do to these points;
//! - b, base and targets, nothing known of them, where they were placed anew;
//! - e, white noise of a coordinate: that of the earlier session, or what the instrument states for the point, whichever is larger; and what the points
//!   of one configuration share, as in the earlier session. Points of one configuration are never taken as independent;
//! - c, a change since. An unchanged robot has c = 0.
//!
//! With V = D·Dᵀ + noise = L·Lᵀ and Q the orthonormal columns that span L⁻¹·B, z = (I − Q·Qᵀ)·L⁻¹·r has m = 3·N − rank Q dimensions. |z|²/m is
//! compared with Fisher's F of m and ν degrees of freedom, ν those of the earlier session's noise. A change c shifts z by (I − Q·Qᵀ)·L⁻¹·E·c: the
//! test alarms with the stated power where the square of that shift is the noncentrality of F that has this power.

use crate::identification::KinematicModel;
use crate::identification::changes::{Causes, Estimate, FALSE_ALARMS, causes, usual_error};
use crate::identification::distributions::{f_tail, noncentrality};
use crate::identification::objective::{Observation, residuals, weighted_jacobian};
use crate::identification::parameters::{Parameter, Quantity, placement_parameters};
use crate::kinematics::reach_mm;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Share of unchanged robots that the test calls changed.
pub const LEVEL: f64 = FALSE_ALARMS;
/// Probability with which a change of the stated size is found.
pub const POWER: f64 = 0.95;
/// No robot returns to a pose, and no tracker measures it, to better than this share of the reach.
const FINEST: f64 = 1e-5;
/// Directions of the placement below this share of the largest are not determined by the points.
const PLACED: f64 = 1e-9;
/// What the placement leaves of an effect, at least, for it to be seen: less is rounding. Of causes, a share of the largest effect of a usual error.
const SEEN: f64 = 1e-6;
/// A zero that would have to turn by more than this, rad, is not seen: the reflector hardly leaves its axis, and derivatives say nothing of such turns.
const MOST_TURN_RAD: f64 = 0.1;
/// Fewer degrees of freedom of the earlier noise decide nothing.
const FEWEST_FREEDOM: f64 = 5.0;
/// Iterations of a decomposition at most.
const SVD_ITERATIONS: usize = 10_000;

/// A few measured points, and what was known before them.
#[derive(Clone, Copy, Debug)]
pub struct Poses<'a> {
    /// The earlier estimate.
    pub before: &'a Estimate,
    /// Its links, with base and targets as in the estimate, or as they were placed anew.
    pub model: &'a KinematicModel,
    /// The points, without rotations; targets counted as in `model`.
    pub observations: &'a [Observation],
    /// The number of each point's configuration.
    pub configurations: &'a [usize],
    /// What the instrument states for a coordinate of each point, mm; 0 where it states nothing.
    pub stated_std_mm: &'a [f64],
    /// Whether base and targets were placed anew.
    pub is_placed_anew: bool,
}

/// The smallest change of one kind that the test finds with probability [`POWER`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detectable {
    /// mm or rad; `None` where these poses do not show it: the placement takes up all of it, or the reflector hardly leaves the joint's axis.
    pub change: Option<f64>,
    /// How far that change moves the target, rms over these points, mm.
    pub tool_mm: Option<f64>,
    /// Where these poses do not show it: how far a turn of [`MOST_TURN_RAD`] moves the target, rms over these points, mm; 0 for shifts.
    pub unseen_tool_mm: f64,
}

/// The test, and what it could have seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// |z|².
    pub statistic: f64,
    /// m: equations less the numbers that were placed.
    pub n_combinations: usize,
    /// ν.
    pub freedom: f64,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
    /// What the earlier estimate and its noise let expect of a point, 3-D, rms, mm.
    pub expected_mm: f64,
    /// Of each joint's zero.
    pub joints: Vec<Detectable>,
    /// Of a shift of the base in the direction in which it shows least.
    pub base: Detectable,
    /// Of a shift of each target in the direction in which it shows least.
    pub targets: Vec<Detectable>,
    /// Index of the configuration that has the largest part of the statistic.
    pub largest_configuration: usize,
    whitened: Whitened,
}

#[derive(Clone, Debug, PartialEq)]
struct Whitened {
    difference: DVector<f64>,
    /// Candidates for a cause, what each does to the rows, and how far it is usually off, mm or rad.
    parameters: Vec<Parameter>,
    effects: DMatrix<f64>,
    scale: Vec<f64>,
}

/// Why nothing can be said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Untestable {
    /// Base and targets take up every equation.
    NothingLeft,
    /// The earlier session hardly tells its own noise.
    NoiseUnknown,
    /// The covariance is not one.
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
    if freedom < FEWEST_FREEDOM {
        return Err(Untestable::NoiseUnknown);
    }
    let covariance = covariance_mm2(poses);
    let root = covariance.clone().cholesky().ok_or(Untestable::Singular)?;
    let whiten = |m: DMatrix<f64>| {
        root.l()
            .solve_lower_triangular(&m)
            .ok_or(Untestable::Singular)
    };
    let placement = placement_parameters(model.targets_mm.len());
    let placed = whiten(jacobian(poses, &placement))?;
    let taken = match poses.is_placed_anew {
        true => span(&placed)?,
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
    let reach_mm = reach_mm(&model.links);
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
            .map(|link| detectable(&zero(link), MOST_TURN_RAD))
            .collect::<Result<_, _>>()?,
        base: detectable(&placement[..3], f64::INFINITY)?,
        targets: (0..model.targets_mm.len())
            .map(|t| detectable(&target(t), f64::INFINITY))
            .collect::<Result<_, _>>()?,
        largest_configuration: largest(&z, poses.configurations),
        whitened: Whitened {
            difference: z.column(0).into(),
            parameters,
            effects,
            scale,
        },
    })
}

impl Checked {
    /// What explains the difference, among the parameters for which `belongs` says yes.
    pub fn causes(&self, belongs: impl Fn(&Parameter) -> bool) -> Causes {
        let all = &self.whitened;
        let effect = |k: usize| all.effects.column(k).norm();
        let largest = (0..all.parameters.len()).map(effect).fold(0.0, f64::max);
        // what the placement takes up leaves rounding alone, which explains nothing
        let is_seen = |k: usize| effect(k) > SEEN * largest;
        let chosen: Vec<usize> = (0..all.parameters.len())
            .filter(|k| belongs(&all.parameters[*k]) && is_seen(*k))
            .collect();
        let parameters: Vec<Parameter> = chosen.iter().map(|k| all.parameters[*k]).collect();
        let scale: Vec<f64> = chosen.iter().map(|k| all.scale[*k]).collect();
        causes(
            &parameters,
            (&all.difference, &all.effects.select_columns(&chosen)),
            (&scale, self.n_combinations, self.freedom),
        )
    }
}

/// Numbers of the links; base and targets where they were not placed anew.
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

/// ∂(predicted position)/∂(parameter), 3·N × p, mm per mm or rad.
fn jacobian(poses: &Poses<'_>, parameters: &[Parameter]) -> DMatrix<f64> {
    let unweighted: Vec<Observation> = poses
        .observations
        .iter()
        .map(|o| Observation {
            weight: 1.0,
            whitening: None,
            ..o.position_alone()
        })
        .collect();
    weighted_jacobian(poses.model, parameters, &unweighted, &Vector3::zeros())
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
    // base and targets of the earlier session are not those that were placed anew
    let counts = |parameter: &Parameter| !poses.is_placed_anew || parameter.is_link();
    let rows: Vec<usize> = (0..p).filter(|j| counts(&before.parameters[*j])).collect();
    let parameters: Vec<Parameter> = rows.iter().map(|j| before.parameters[*j]).collect();
    let mut errors = jacobian(poses, &parameters) * known.root.select_rows(&rows);
    if known.root.nrows() > p {
        let here = observations
            .iter()
            .map(|o| (o.q_rad.as_slice(), o.target, 1.0));
        errors += known.features.features(model, here) * known.root.rows(p, known.root.nrows() - p);
    }
    let mut covariance = &errors * errors.transpose();
    let finest_mm = FINEST * reach_mm(&model.links) / 3.0_f64.sqrt();
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

/// Orthonormal columns that span what the placement can do to the points.
fn span(placed: &DMatrix<f64>) -> Result<DMatrix<f64>, Untestable> {
    let mut scaled = placed.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let svd = scaled
        .try_svd(true, false, f64::EPSILON, SVD_ITERATIONS)
        .ok_or(Untestable::Singular)?;
    let u = svd.u.ok_or(Untestable::Singular)?;
    let largest = svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len())
        .filter(|k| svd.singular_values[*k] > PLACED * largest)
        .collect();
    Ok(u.select_columns(&kept))
}

/// The change, in the direction in which it shows least, that shifts the rows by `shift`. `raw` is what a unit of each parameter does to the points,
/// mm; `whole` the same whitened, and `left` what the placement leaves of that. A change of more than `most` is not seen.
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
    if seen <= SEEN * all {
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

fn largest(z: &DMatrix<f64>, configurations: &[usize]) -> usize {
    let n = configurations.iter().map(|c| c + 1).max().unwrap_or(0);
    let mut of_each = vec![0.0; n];
    for (i, configuration) in configurations.iter().enumerate() {
        of_each[*configuration] += z.rows(3 * i, 3).norm_squared();
    }
    (0..n)
        .max_by(|a, b| of_each[*a].total_cmp(&of_each[*b]).then(b.cmp(a)))
        .unwrap_or(0)
}
