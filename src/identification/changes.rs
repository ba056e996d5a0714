//! What two sessions of one robot say differently, and whether that is more than chance.
//!
//! Compared are the combinations of parameters that both sessions see, d = after − before, with the covariance of both:
//! V = V₁ + V₂ + (M₁ − M₂)·(M₁ − M₂)ᵀ. V₁ and V₂ are of noise; M₁ and M₂ say how the misfit of the model bends each session's
//! parameters: it is the same robot's, so that what bends both alike is no difference. First one joint test, dᵀ·V⁻¹·d against Fisher's F;
//! only where it alarms are parameters named, by forward selection: the one that explains most, then the one that explains most of the
//! rest, until the rest is within chance.

use crate::identification::KinematicModel;
use crate::identification::distributions::{f_tail, t_half_width};
use crate::identification::evidence::Noise;
use crate::identification::identifiability::{Decomposition, prior_scales};
use crate::identification::parameters::{Parameter, deviation_from};
use crate::identification::uncertainty::Uncertainty;
use crate::kinematics::reach_mm;
use nalgebra::{DMatrix, DVector};

/// Share of unchanged robots that are called changed.
pub const FALSE_ALARMS: f64 = 0.01;
/// What displaces the points by less than this share of what counts as seen, rms, is no change however exact the data. Two sessions are compared
/// along derivatives, and those are not exact.
const RESOLUTION: f64 = 0.1;
/// Parameters whose effects on what both see have at least this cosine cannot be told apart.
const SAME_EFFECT: f64 = 0.9999;
/// What the chosen parameters leave of another one's effect, at least, for it to be a choice of its own: the sine to [`SAME_EFFECT`].
const OWN_EFFECT: f64 = 0.014;
/// A parameter of which less than this share is seen is not named: what is said of it is said of others.
const HARDLY_SEEN: f64 = 0.05;
/// Iteration limit of an eigenvalue decomposition.
const EIGEN_ITERATIONS: usize = 10_000;

/// What one session says.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// The identified model.
    pub model: KinematicModel,
    /// How far it may be off.
    pub uncertainty: Uncertainty,
    /// What the session sees.
    pub decomposition: Decomposition,
    /// What the model leaves over of the session.
    pub noise: Noise,
}

/// One thing that changed.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The parameters that it may be: one, or several that have the same effect on everything both sessions see.
    pub parameters: Vec<Parameter>,
    /// after − before of the first of them, mm or rad.
    pub delta: f64,
    /// |delta| in units of its standard deviation.
    pub sigmas: f64,
}

/// One joint test, and the names where it alarms.
#[derive(Clone, Debug, PartialEq)]
pub struct Tested {
    /// dᵀ·V⁻¹·d.
    pub chi_square: f64,
    /// Combinations that both sessions see.
    pub n_combinations: usize,
    /// Probability that an unchanged robot shows as much.
    pub probability: f64,
    /// What changed; empty where the test does not alarm.
    pub changes: Vec<Change>,
}

/// The links, and apart from them the placement: base and targets.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The robot itself.
    pub robot: Tested,
    /// The base, where it is identified, and each target.
    pub placement: Vec<Tested>,
}

/// How the misfits of two sessions go together.
#[derive(Clone, Copy, PartialEq)]
enum Misfit {
    /// The parameters are the robot's own: what bends both alike cancels.
    Cancels,
    /// The parameters are along axes that may have been turned in between.
    Adds,
}

/// Compares two sessions of one robot. `None` where they have no combination of link parameters in common.
pub fn compare(before: &Estimate, after: &Estimate) -> Option<Comparison> {
    let robot = tested(
        before,
        after,
        &common(before, after, |p| p.is_link()),
        Misfit::Cancels,
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
        Misfit::Adds,
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
            |p| matches!(p, Parameter::Target(t, _) if *t == target),
        );
        placement.push(tested(
            before,
            after,
            &of_target,
            Misfit::Cancels,
            named_each,
        ));
    }
    Some(Comparison {
        robot,
        placement: placement.into_iter().flatten().collect(),
    })
}

/// A parameter that both sessions identify, and where it stands in each.
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

/// The difference, whitened: noise of unit variance along every row.
struct Whitened {
    difference: DVector<f64>,
    /// Of a change of each common parameter by its prior scale.
    effects: DMatrix<f64>,
    scale: Vec<f64>,
    /// Degrees of freedom of the estimated variance.
    freedom: f64,
}

/// Names what changed, given the whitened difference.
type Naming = fn(&[Common], &Whitened) -> Vec<Change>;

fn tested(
    before: &Estimate,
    after: &Estimate,
    common: &[Common],
    misfit: Misfit,
    naming: Naming,
) -> Option<Tested> {
    let whitened = whitened(before, after, common, misfit)?;
    let n_combinations = whitened.difference.len();
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

fn whitened(
    before: &Estimate,
    after: &Estimate,
    common: &[Common],
    misfit: Misfit,
) -> Option<Whitened> {
    if common.is_empty() {
        return None;
    }
    let parameters: Vec<Parameter> = common.iter().map(|c| c.parameter).collect();
    let scale = prior_scales(&parameters, reach_mm(&before.model.links));
    let at_before: Vec<usize> = common.iter().map(|c| c.before).collect();
    let at_after: Vec<usize> = common.iter().map(|c| c.after).collect();
    let rows = |of: &DMatrix<f64>, at: &[usize]| {
        DMatrix::from_fn(at.len(), of.ncols(), |row, column| {
            of[(at[row], column)] / scale[row]
        })
    };
    let covariance = |root: DMatrix<f64>| &root * root.transpose();
    let (u, v) = (&before.uncertainty, &after.uncertainty);
    let noise = [
        covariance(rows(&u.noise, &at_before)),
        covariance(rows(&v.noise, &at_after)),
    ];
    let bent = bent(
        rows(&u.misfit, &at_before),
        rows(&v.misfit, &at_after),
        [u.misfit_std_rad, v.misfit_std_rad],
        misfit,
    );
    let bent = bent
        .into_iter()
        .map(covariance)
        .fold(DMatrix::zeros(common.len(), common.len()), |sum, part| {
            sum + part
        });
    let unresolved = covariance(rows(&resolution(before), &at_before))
        + covariance(rows(&resolution(after), &at_after));
    let variance = &noise[0] + &noise[1] + &bent + unresolved;
    let root = variance.cholesky()?;
    let whiten = |m: &DMatrix<f64>| root.l().solve_lower_triangular(m);
    let difference = DMatrix::from_iterator(
        common.len(),
        1,
        common
            .iter()
            .zip(&scale)
            .map(|(c, s)| deviation_from(&before.model, &after.model, &c.parameter) / s),
    );
    // Satterthwaite (1946): each part's share of the variance, averaged over the combinations
    let share = |part: &DMatrix<f64>| root.solve(part).trace() / common.len() as f64;
    let parts = [
        (&noise[0], u.freedom_of(1.0, 0.0)),
        (&noise[1], v.freedom_of(1.0, 0.0)),
        (&bent, misfit_freedom(u, v)),
    ];
    let spread: f64 = parts
        .iter()
        .map(|(part, freedom)| share(part) * share(part) / freedom)
        .sum();
    Some(Whitened {
        difference: whiten(&difference)?.column(0).into(),
        effects: whiten(&DMatrix::identity(common.len(), common.len()))?,
        scale,
        freedom: 1.0 / spread.max(1.0 / MOST_FREEDOM),
    })
}

/// Stands for a variance that is known.
const MOST_FREEDOM: f64 = 1e6;

/// The roots of the misfit's covariance: of the difference of both where features are the same, else of each.
fn bent(
    before: DMatrix<f64>,
    after: DMatrix<f64>,
    std_rad: [f64; 2],
    misfit: Misfit,
) -> Vec<DMatrix<f64>> {
    if misfit == Misfit::Adds || before.ncols() != after.ncols() || before.ncols() == 0 {
        return vec![before, after];
    }
    let common_rad = ((std_rad[0] * std_rad[0] + std_rad[1] * std_rad[1]) / 2.0).sqrt();
    vec![after * (common_rad / std_rad[1]) - before * (common_rad / std_rad[0])]
}

fn misfit_freedom(before: &Uncertainty, after: &Uncertainty) -> f64 {
    let of = |u: &Uncertainty| {
        if u.misfit_std_rad > 0.0 {
            u.freedom_of(0.0, 1.0)
        } else {
            0.0
        }
    };
    (of(before) + of(after)).max(1.0)
}

/// The combinations that a session sees, each by as much as displaces its points by [`RESOLUTION`].
fn resolution(estimate: &Estimate) -> DMatrix<f64> {
    let mut directions = estimate.decomposition.seen_directions();
    for (mut column, sigma) in directions
        .column_iter_mut()
        .zip(&estimate.decomposition.singular_values)
    {
        column *= RESOLUTION * estimate.decomposition.visible_mm / sigma;
    }
    directions
}

/// Forward selection until the rest is within chance.
fn named_by_selection(common: &[Common], whitened: &Whitened) -> Vec<Change> {
    let n = whitened.difference.len();
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
        let direction = apart.column(best).normalize();
        rest -= &direction * direction.dot(&rest);
        apart -= &direction * (direction.transpose() * &apart);
        chosen.push(best);
    }
    together(common, whitened, &chosen)
}

/// The chosen parameters fitted together to the whitened difference, those that changed most first.
fn together(common: &[Common], whitened: &Whitened, chosen: &[usize]) -> Vec<Change> {
    let effects = whitened.effects.select_columns(chosen);
    let square = effects.tr_mul(&effects);
    let Some(covariance) = pseudo_inverse(square.clone(), whitened.difference.len()) else {
        return vec![];
    };
    // how much of each parameter is seen: 1, but for those in a combination that is not
    let seen = &covariance * square;
    let fitted = &covariance * effects.transpose() * &whitened.difference;
    let change = |(k, j): (usize, &usize)| Change {
        parameters: alike(common, whitened, *j),
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

/// The inverse on the span of the `rank` largest eigenvalues: where both sessions see fewer combinations than there are parameters, the
/// smallest change that shows as much.
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

/// The parameters with the same effect on everything both sessions see, the chosen one first.
fn alike(common: &[Common], whitened: &Whitened, chosen: usize) -> Vec<Parameter> {
    let direction = whitened.effects.column(chosen).normalize();
    let is_alike = |j: &usize| {
        let effect = whitened.effects.column(*j);
        *j != chosen
            && effect.dot(&direction).abs() > SAME_EFFECT * effect.norm()
            && effect.norm() > 0.0
    };
    std::iter::once(chosen)
        .chain((0..common.len()).filter(is_alike))
        .map(|j| common[j].parameter)
        .collect()
}

/// Every parameter for itself, where it stands out of chance with as many looked at.
fn named_each(common: &[Common], whitened: &Whitened) -> Vec<Change> {
    let stands_out = t_half_width(1.0 - FALSE_ALARMS / common.len() as f64, whitened.freedom);
    let all: Vec<usize> = (0..common.len()).collect();
    together(common, whitened, &all)
        .into_iter()
        .filter(|change| change.sigmas > stands_out)
        .collect()
}
