//! The whitened difference of two sessions, and the parameters whose changes explain it.

use crate::identification::model::parameters::Parameter;
use crate::identification::statistics::distributions::{f_tail, t_half_width};
use crate::solvers::orthonormal::orthonormal;
use nalgebra::{DMatrix, DVector};

/// Significance level: share of unchanged robots that are called changed.
pub const FALSE_ALARMS: f64 = 0.01;
/// Parameters are indistinguishable if the cosine between their effects on the common rows of both sessions is at least this.
const SAME_EFFECT: f64 = 0.9999;
/// See [`alike`].
const MAX_STDS_APART: f64 = 3.0;
/// A parameter is chosen in addition only if at least this part of its effect is not explained by the parameters chosen before: the sine
/// that belongs to [`SAME_EFFECT`].
const MIN_OWN_EFFECT: f64 = 0.014;
/// A parameter is not named if less than this share of it is observable, because its change is then that of other parameters.
const MIN_OBSERVABLE_SHARE: f64 = 0.05;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// One change.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The parameter that changed, or several with the same effect on all common rows of both sessions.
    pub parameters: Vec<Parameter>,
    /// after − before of the first parameter, mm or rad.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

impl Change {
    /// The names of its parameters, joined by "or".
    pub fn name(&self) -> String {
        let names: Vec<String> = self.parameters.iter().map(Parameter::name).collect();
        names.join(" or ")
    }
}

/// A difference between expected and measured values, whitened to noise of unit variance in every row.
#[derive(Clone, Debug, PartialEq)]
pub struct Whitened {
    /// The difference.
    pub difference: DVector<f64>,
    /// Parameters whose changes may explain it.
    pub parameters: Vec<Parameter>,
    /// Effects on the rows of a change of each parameter by its scale.
    pub effects: DMatrix<f64>,
    /// Standard deviation of each parameter of new robots, mm or rad.
    pub scale: Vec<f64>,
    /// Number of combinations that are determined.
    pub n_combinations: usize,
    /// Degrees of freedom of the variance that was used for whitening.
    pub freedom: f64,
}

impl Whitened {
    /// The same difference with only some of the parameters.
    pub fn with_parameters(&self, chosen: &[usize]) -> Self {
        Self {
            parameters: chosen.iter().map(|k| self.parameters[*k]).collect(),
            effects: self.effects.select_columns(chosen),
            scale: chosen.iter().map(|k| self.scale[*k]).collect(),
            ..self.clone()
        }
    }
}

/// Probability that chance alone gives at least this chi-square of `n` combinations.
pub(super) fn tail(chi_square: f64, n: usize, freedom: f64) -> f64 {
    f_tail(chi_square / n as f64, n as f64, freedom)
}

/// Forward selection until the rest is not significant.
pub(super) fn named_by_selection(whitened: &Whitened) -> Vec<Change> {
    let n = whitened.n_combinations;
    let mut chosen: Vec<usize> = Vec::new();
    let (mut rest, mut apart) = (whitened.difference.clone(), whitened.effects.clone());
    while chosen.len() < n
        && tail(rest.norm_squared(), n - chosen.len(), whitened.freedom) < FALSE_ALARMS
    {
        let explained = |j: &usize| {
            let length = apart.column(*j).norm();
            if length <= MIN_OWN_EFFECT * whitened.effects.column(*j).norm() {
                0.0
            } else {
                (apart.column(*j).dot(&rest) / length).abs()
            }
        };
        let Some(best) = (0..whitened.parameters.len())
            .max_by(|i, j| explained(i).total_cmp(&explained(j)).then(j.cmp(i)))
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
    together(whitened, &without_superfluous(whitened, chosen))
}

/// Removes parameters that later choices made superfluous, the least important first, as long as the rest stays insignificant.
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
fn together(whitened: &Whitened, chosen: &[usize]) -> Vec<Change> {
    if chosen.is_empty() {
        return vec![];
    }
    let effects = whitened.effects.select_columns(chosen);
    let square = effects.tr_mul(&effects);
    let Some(covariance) = pseudo_inverse(square.clone(), whitened.n_combinations) else {
        return vec![];
    };
    // Observable share of each parameter: 1, except in combinations that are not observable.
    let seen = &covariance * square;
    let fitted = &covariance * effects.transpose() * &whitened.difference;
    let change = |(k, j): (usize, &usize)| Change {
        parameters: alike(whitened, *j)
            .into_iter()
            .map(|j| whitened.parameters[j])
            .collect(),
        delta: fitted[k] * whitened.scale[*j],
        sigmas: fitted[k].abs() / covariance[(k, k)].sqrt(),
    };
    let hardly_seen = |k: usize| seen[(k, k)] < MIN_OBSERVABLE_SHARE;
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

/// The parameters with the same effect on all common rows of both sessions, the most probable first. A parameter is left out if its change
/// would be more than [`MAX_STDS_APART`] times as many standard deviations.
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
    all.retain(|j| MAX_STDS_APART * effects.column(*j).norm() > most);
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

/// Names the causes of a whitened difference.
pub fn causes(whitened: &Whitened) -> Causes {
    let changes = named_by_selection(whitened);
    let place = |change: &Change| {
        let mut parameters = whitened.parameters.iter();
        parameters.position(|p| *p == change.parameters[0])
    };
    let named: Vec<usize> = changes.iter().filter_map(place).collect();
    let rest = left_over(whitened, &named);
    let leaves = match whitened.n_combinations.saturating_sub(named.len()) {
        0 => 1.0,
        n => tail(rest.norm_squared(), n, whitened.freedom),
    };
    Causes { changes, leaves }
}

/// Tests every parameter separately, with a level that accounts for the number of tests.
pub(super) fn named_each(whitened: &Whitened) -> Vec<Change> {
    let n = whitened.parameters.len();
    let stands_out = t_half_width(1.0 - FALSE_ALARMS / n as f64, whitened.freedom);
    let all: Vec<usize> = (0..n).collect();
    together(whitened, &all)
        .into_iter()
        .filter(|change| change.sigmas > stands_out)
        .collect()
}
