//! Differences between two sessions of one robot, and whether they are significant.
//!
//! The most probable parameters of both sessions are compared, d = after − before. With a posterior covariance C and a prior covariance P, a
//! session's estimate contains the share (I − C·P⁻¹) of the true parameters, plus noise. The variance of d is the noise of both sessions plus (C₁ −
//! C₂)·P⁻¹·(C₁ − C₂). The robot's deviation from its prior and the misfit of the model are the same in both sessions, so they contribute only where
//! the sessions show them differently. First there is one joint test of dᵀ·V⁻¹·d against Fisher's F. Parameters are named only if this test is
//! significant, by forward selection: first the one that explains most, then the one that explains most of the rest, until the rest is not
//! significant.

use crate::identification::KinematicModel;
use crate::identification::distributions::{f_tail, t_half_width};
use crate::identification::evidence::Noise;
use crate::identification::parameters::{Parameter, Quantity, deviation_from};
use crate::identification::problem::variable;
use crate::identification::uncertainty::Uncertainty;
use crate::kinematics::reach_mm;
use crate::solvers::orthonormal::orthonormal;
use nalgebra::{DMatrix, DVector};

/// Significance level: share of unchanged robots that are called changed.
pub const FALSE_ALARMS: f64 = 0.01;
/// Changes below this share of [`usual_error`] do not count, however exact the data are: sessions are compared along derivatives, which are not
/// exact.
const RESOLUTION: f64 = 1e-3;
/// Parameters cannot be told apart if the cosine between their effects on what both sessions see is at least this.
const SAME_EFFECT: f64 = 0.9999;
/// See [`alike`].
const IMPROBABLE: f64 = 3.0;
/// Minimum part of a parameter's effect that the chosen parameters do not explain, for choosing it as well: the sine that belongs to [`SAME_EFFECT`].
const OWN_EFFECT: f64 = 0.014;
/// A parameter is not named if less than this share of it is observable: its change is then that of other parameters.
const HARDLY_SEEN: f64 = 0.05;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// The estimate of one session.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The identified model.
    pub model: KinematicModel,
    /// Its uncertainty.
    pub uncertainty: Uncertainty,
    /// Noise of the session about the model.
    pub noise: Noise,
}

/// One change.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The parameter that changed, or several that have the same effect on everything that both sessions see.
    pub parameters: Vec<Parameter>,
    /// after − before of the first parameter, mm or rad.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// One joint test, and the changes if it is significant.
#[derive(Clone, Debug, PartialEq)]
pub struct Tested {
    /// dᵀ·V⁻¹·d.
    pub chi_square: f64,
    /// Number of combinations that both sessions determine.
    pub n_combinations: usize,
    /// Probability that an unchanged robot gives at least this value.
    pub probability: f64,
    /// What changed; empty if the test is not significant.
    pub changes: Vec<Change>,
}

/// Comparison of the links, and separately of the placement: base and targets.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The robot itself.
    pub robot: Tested,
    /// The base, if it is identified, and each target.
    pub placement: Vec<Tested>,
}

/// Compares two sessions of one robot. `None` if no combination of link parameters is common to both.
pub fn compare(before: &Estimate, after: &Estimate) -> Option<Comparison> {
    let robot = tested(
        before,
        after,
        &common(before, after, |p| p.is_link()),
        named_by_selection,
    )?;
    let is_base = |p: &Parameter| {
        matches!(
            p,
            Parameter::BaseTranslation(_) | Parameter::BaseRotation(_)
        )
    };
    let mut placement = vec![tested(
        before,
        after,
        &common(before, after, is_base),
        named_each,
    )];
    for target in 0..before
        .model
        .targets_mm
        .len()
        .min(after.model.targets_mm.len())
    {
        let of_target = common(
            before,
            after,
            |p| matches!(p, Parameter::Target(t, _) | Parameter::TargetRotation(t, _) if *t == target),
        );
        placement.push(tested(before, after, &of_target, named_each));
    }
    Some(Comparison {
        robot,
        placement: placement.into_iter().flatten().collect(),
    })
}

/// A parameter that both sessions identify, with its index in each.
struct Common {
    parameter: Parameter,
    before: usize,
    after: usize,
}

fn common(
    before: &Estimate,
    after: &Estimate,
    belongs: impl Fn(&Parameter) -> bool,
) -> Vec<Common> {
    let position = |p: &Parameter| before.parameters.iter().position(|b| b == p);
    let all = after
        .parameters
        .iter()
        .enumerate()
        .filter(|(_, p)| belongs(p));
    all.filter_map(|(i, p)| {
        Some(Common {
            parameter: *p,
            before: position(p)?,
            after: i,
        })
    })
    .collect()
}

/// The difference, whitened to noise of unit variance in every row.
struct Whitened {
    difference: DVector<f64>,
    /// Effects of a change of each common parameter by its scale.
    effects: DMatrix<f64>,
    /// Number of combinations that are determined.
    n_combinations: usize,
    /// Standard deviation of each common parameter of new robots, mm or rad.
    scale: Vec<f64>,
    /// Degrees of freedom of the estimated variance.
    freedom: f64,
}

/// Names what changed, from the whitened difference.
type Naming = fn(&[Common], &Whitened) -> Vec<Change>;

fn tested(
    before: &Estimate,
    after: &Estimate,
    common: &[Common],
    naming: Naming,
) -> Option<Tested> {
    let whitened = whitened(before, after, common)?;
    let n_combinations = whitened.n_combinations;
    if n_combinations == 0 {
        return None;
    }
    let chi_square = whitened.difference.norm_squared();
    let probability = tail(chi_square, n_combinations, whitened.freedom);
    let changes = if probability < FALSE_ALARMS {
        naming(common, &whitened)
    } else {
        vec![]
    };
    Some(Tested {
        chi_square,
        n_combinations,
        probability,
        changes,
    })
}

fn tail(chi_square: f64, n: usize, freedom: f64) -> f64 {
    f_tail(chi_square / n as f64, n as f64, freedom)
}

fn whitened(before: &Estimate, after: &Estimate, common: &[Common]) -> Option<Whitened> {
    if common.is_empty() {
        return None;
    }
    let reach_mm = reach_mm(&before.model.links);
    let scale: Vec<f64> = common
        .iter()
        .map(|c| usual_error(c.parameter, reach_mm))
        .collect();
    let at_before: Vec<usize> = common.iter().map(|c| c.before).collect();
    let at_after: Vec<usize> = common.iter().map(|c| c.after).collect();
    let (u, v) = (&before.uncertainty, &after.uncertainty);
    // prior knowledge that both sessions share: parameters by name, and features if they are the same
    let known = Known::new(before, after);
    let rows = |of: DMatrix<f64>, at: &[usize]| {
        DMatrix::from_fn(at.len(), of.ncols(), |row, column| {
            of[(at[row], column)] / scale[row]
        })
    };
    let square = |root: &DMatrix<f64>| root * root.transpose();
    let noise = [
        square(&rows(u.of_noise.clone(), &at_before)),
        square(&rows(v.of_noise.clone(), &at_after)),
    ];
    let (pulled, moved) = (
        rows(known.pull(u, &known.before), &at_before),
        rows(known.pull(v, &known.after), &at_after),
    );
    let pull = square(&(&moved - &pulled));
    let effects = DMatrix::from_fn(common.len(), common.len(), |i, j| {
        v.shown(at_after[i], at_after[j]) * scale[j] / scale[i]
    });
    let unresolved =
        DMatrix::from_diagonal_element(common.len(), common.len(), RESOLUTION * RESOLUTION);
    let by_chance = &noise[0] + &noise[1] + pull;
    let seen = &by_chance + square(&effects);
    let n_combinations = (&seen + &unresolved)
        .cholesky()?
        .solve(&seen)
        .trace()
        .round() as usize;
    let root = (by_chance + unresolved).cholesky()?;
    let whiten = |m: &DMatrix<f64>| root.l().solve_lower_triangular(m);
    let difference = common.iter().zip(&scale).map(|(c, scale)| {
        let moved = deviation_from(&before.model, &after.model, &c.parameter);
        (moved + v.mean(c.after) - u.mean(c.before)) / scale
    });
    let difference = DMatrix::from_iterator(common.len(), 1, difference);
    // Satterthwaite (1946): the share of each part in the variance, averaged over the combinations
    let n = n_combinations.max(1) as f64;
    let share = |part: &DMatrix<f64>| root.solve(part).trace() / n;
    let spread: f64 = [(&noise[0], u.freedom), (&noise[1], v.freedom)]
        .iter()
        .map(|(part, freedom)| share(part) * share(part) / freedom)
        .sum();
    Some(Whitened {
        difference: whiten(&difference)?.column(0).into(),
        effects: whiten(&effects)?,
        n_combinations,
        scale,
        freedom: 1.0 / spread.max(1.0 / MOST_FREEDOM),
    })
}

/// Standard deviation of a parameter of new robots, mm or rad. For base and targets, that of a link parameter of the same unit is used.
pub fn usual_error(parameter: Parameter, reach_mm: f64) -> f64 {
    let of_link = match parameter {
        Parameter::Link(..) => parameter,
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => {
            Parameter::Link(0, Quantity::Alpha)
        }
        Parameter::BaseTranslation(_) | Parameter::Target(..) => Parameter::Link(0, Quantity::A),
    };
    variable(of_link, reach_mm).width
}

/// Degrees of freedom that stand for a known variance.
const MOST_FREEDOM: f64 = 1e6;

/// Prior knowledge that two sessions share: its index in each session, and the standard deviation of the prior.
struct Known {
    before: Vec<usize>,
    after: Vec<usize>,
    std: Vec<f64>,
}

impl Known {
    fn new(before: &Estimate, after: &Estimate) -> Self {
        let (u, v) = (&before.uncertainty, &after.uncertainty);
        let mut pairs: Vec<(usize, usize)> = common(before, after, |_| true)
            .iter()
            .map(|c| (c.before, c.after))
            .collect();
        if u.features == v.features {
            let n_features =
                (u.prior_std.len() - u.n_parameters).min(v.prior_std.len() - v.n_parameters);
            pairs.extend((0..n_features).map(|k| (u.n_parameters + k, v.n_parameters + k)));
        }
        let mean_square = |a: f64, b: f64| ((a * a + b * b) / 2.0).sqrt();
        Self {
            std: pairs
                .iter()
                .map(|(i, j)| mean_square(u.prior_std[*i], v.prior_std[*j]))
                .collect(),
            before: pairs.iter().map(|(i, _)| *i).collect(),
            after: pairs.iter().map(|(_, j)| *j).collect(),
        }
    }

    /// C·P⁻¹·S: effect of an error of each prior, one standard deviation, on the most probable values of a session.
    fn pull(&self, of: &Uncertainty, at: &[usize]) -> DMatrix<f64> {
        let covariance = of.covariance();
        DMatrix::from_fn(covariance.nrows(), at.len(), |i, k| {
            let own = of.prior_std[at[k]];
            covariance[(i, at[k])] * self.std[k] / (own * own)
        })
    }
}

/// Forward selection until the rest is not significant.
fn named_by_selection(common: &[Common], whitened: &Whitened) -> Vec<Change> {
    let n = whitened.n_combinations;
    let mut chosen: Vec<usize> = Vec::new();
    let (mut rest, mut apart) = (whitened.difference.clone(), whitened.effects.clone());
    while chosen.len() < n
        && tail(rest.norm_squared(), n - chosen.len(), whitened.freedom) < FALSE_ALARMS
    {
        let explained = |j: &usize| {
            let length = apart.column(*j).norm();
            if length <= OWN_EFFECT * whitened.effects.column(*j).norm() {
                0.0
            } else {
                (apart.column(*j).dot(&rest) / length).abs()
            }
        };
        let Some(best) =
            (0..common.len()).max_by(|i, j| explained(i).total_cmp(&explained(j)).then(j.cmp(i)))
        else {
            break;
        };
        if explained(&best) == 0.0 {
            break;
        }
        let best = alike(whitened, best)[0];
        let direction = apart.column(best).normalize();
        rest -= &direction * direction.dot(&rest);
        apart -= &direction * (direction.transpose() * &apart);
        chosen.push(best);
    }
    together(common, whitened, &without_superfluous(whitened, chosen))
}

/// Removes parameters that later choices have made superfluous, the least important first, as long as the rest stays insignificant.
fn without_superfluous(whitened: &Whitened, mut chosen: Vec<usize>) -> Vec<usize> {
    let n = whitened.n_combinations;
    while chosen.len() > 1 {
        let without = |k: usize| {
            let mut others = chosen.clone();
            others.remove(k);
            let left = left_over(whitened, &others).norm_squared();
            (left, others)
        };
        let least = (0..chosen.len())
            .map(without)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        match least {
            Some((left, others))
                if tail(left, n - others.len(), whitened.freedom) >= FALSE_ALARMS =>
            {
                chosen = others;
            }
            _ => break,
        }
    }
    chosen
}

/// The part of the difference that the chosen parameters do not explain.
fn left_over(whitened: &Whitened, chosen: &[usize]) -> DVector<f64> {
    if chosen.is_empty() {
        return whitened.difference.clone();
    }
    let span = orthonormal(whitened.effects.select_columns(chosen));
    &whitened.difference - &span * span.tr_mul(&whitened.difference)
}

/// Fits the chosen parameters together to the whitened difference. The most significant change comes first.
fn together(common: &[Common], whitened: &Whitened, chosen: &[usize]) -> Vec<Change> {
    if chosen.is_empty() {
        return vec![];
    }
    let effects = whitened.effects.select_columns(chosen);
    let square = effects.tr_mul(&effects);
    let Some(covariance) = pseudo_inverse(square.clone(), whitened.n_combinations) else {
        return vec![];
    };
    // observable share of each parameter: 1, except in combinations that are not observable
    let seen = &covariance * square;
    let fitted = &covariance * effects.transpose() * &whitened.difference;
    let change = |(k, j): (usize, &usize)| Change {
        parameters: alike(whitened, *j)
            .into_iter()
            .map(|j| common[j].parameter)
            .collect(),
        delta: fitted[k] * whitened.scale[*j],
        sigmas: fitted[k].abs() / covariance[(k, k)].sqrt(),
    };
    let hardly_seen = |k: usize| seen[(k, k)] < HARDLY_SEEN;
    let changes = chosen
        .iter()
        .enumerate()
        .filter(|(k, _)| !hardly_seen(*k))
        .map(change);
    let mut changes: Vec<Change> = changes
        .filter(|c| c.delta.is_finite() && c.sigmas.is_finite())
        .collect();
    changes.sort_by(|a, b| b.sigmas.total_cmp(&a.sigmas));
    changes
}

/// Pseudo-inverse on the span of the `rank` largest eigenvalues. If both sessions determine fewer combinations than there are parameters, it gives
/// the smallest change that explains the difference.
fn pseudo_inverse(square: DMatrix<f64>, rank: usize) -> Option<DMatrix<f64>> {
    let eigen = square.try_symmetric_eigen(f64::EPSILON, EIGEN_ITERATIONS)?;
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|i, j| {
        eigen.eigenvalues[*j]
            .total_cmp(&eigen.eigenvalues[*i])
            .then(i.cmp(j))
    });
    let n = order.len();
    Some(
        order
            .into_iter()
            .take(rank)
            .fold(DMatrix::zeros(n, n), |sum, k| {
                let direction = eigen.eigenvectors.column(k);
                sum + direction * direction.transpose() / eigen.eigenvalues[k]
            }),
    )
}

/// The parameters with the same effect on everything that both sessions see, the most probable one first. Parameters are left out if they would have
/// to change by [`IMPROBABLE`] times as many standard deviations.
fn alike(whitened: &Whitened, chosen: usize) -> Vec<usize> {
    let effects = &whitened.effects;
    let direction = effects.column(chosen).normalize();
    let is_alike = |j: &usize| {
        let effect = effects.column(*j);
        effect.dot(&direction).abs() > SAME_EFFECT * effect.norm()
    };
    let mut all: Vec<usize> = (0..effects.ncols()).filter(is_alike).collect();
    all.sort_by(|i, j| {
        effects
            .column(*j)
            .norm()
            .total_cmp(&effects.column(*i).norm())
    });
    let most = all.first().map_or(0.0, |j| effects.column(*j).norm());
    all.retain(|j| IMPROBABLE * effects.column(*j).norm() > most);
    all
}

/// The likely causes among some parameters, and the unexplained rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Causes {
    /// The causes by forward selection, the largest in units of its standard deviation first.
    pub changes: Vec<Change>,
    /// Probability that chance alone leaves a rest as large.
    pub leaves: f64,
}

/// Names the causes of a whitened difference of unit variance. `effects` has a column for each parameter: the effect on every row of a change by its
/// `scale` (mm or rad). `freedom` is the degrees of freedom of the variance that was used for whitening.
pub fn causes(
    parameters: &[Parameter],
    (difference, effects): (&DVector<f64>, &DMatrix<f64>),
    (scale, n_combinations, freedom): (&[f64], usize, f64),
) -> Causes {
    let common: Vec<Common> = parameters
        .iter()
        .enumerate()
        .map(|(k, parameter)| Common {
            parameter: *parameter,
            before: k,
            after: k,
        })
        .collect();
    let whitened = Whitened {
        difference: difference.clone(),
        effects: effects.clone(),
        n_combinations,
        scale: scale.to_vec(),
        freedom,
    };
    let changes = named_by_selection(&common, &whitened);
    let place = |change: &Change| parameters.iter().position(|p| *p == change.parameters[0]);
    let named: Vec<usize> = changes.iter().filter_map(place).collect();
    let rest = left_over(&whitened, &named);
    let n_left = n_combinations.saturating_sub(named.len());
    let leaves = match n_left {
        0 => 1.0,
        n => tail(rest.norm_squared(), n, freedom),
    };
    Causes { changes, leaves }
}

/// Tests every parameter separately, with a level that accounts for the number of tests.
fn named_each(common: &[Common], whitened: &Whitened) -> Vec<Change> {
    let stands_out = t_half_width(1.0 - FALSE_ALARMS / common.len() as f64, whitened.freedom);
    let all: Vec<usize> = (0..common.len()).collect();
    together(common, whitened, &all)
        .into_iter()
        .filter(|change| change.sigmas > stands_out)
        .collect()
}
