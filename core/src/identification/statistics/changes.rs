//! Differences between two sessions of one robot, and whether they are significant.
//!
//! The most probable parameters of both sessions are compared, d = after − before. With a posterior covariance C and a prior covariance P,
//! a session's estimate contains the share (I − C·P⁻¹) of the true parameters, plus noise. The variance of d is the noise of both sessions
//! plus (C₁ − C₂)·P⁻¹·(C₁ − C₂). The robot's deviation from its prior and the misfit of the model are the same in both sessions, so they
//! contribute only if the sessions show them differently. First, one joint test compares dᵀ·V⁻¹·d with Fisher's F. Parameters are named
//! only if this test is significant, by forward selection: first the one that explains most, then the one that explains most of the rest,
//! until the rest is not significant.

pub use crate::identification::statistics::difference::{Change, FALSE_ALARMS};
pub use crate::identification::statistics::estimate::Estimate;

use crate::identification::least_squares::problem::variable;
use crate::identification::model::parameters::{Parameter, Quantity, deviation_from};
use crate::identification::statistics::difference::{
    Whitened, named_by_selection, named_each, tail,
};
use crate::identification::statistics::uncertainty::Uncertainty;
use nalgebra::DMatrix;

/// Changes below this share of [`usual_error`] do not count, however exact the data are. The comparison uses derivatives and is therefore
/// not exact.
const RESOLUTION: f64 = 1e-3;

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
    let mut placement = vec![compare_base(before, after)];
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

/// Compares the position and rotation of the base in the measuring frame. `None` if the base was not identified in both sessions.
pub fn compare_base(before: &Estimate, after: &Estimate) -> Option<Tested> {
    let is_base = |p: &Parameter| {
        matches!(
            p,
            Parameter::BaseTranslation(_) | Parameter::BaseRotation(_)
        )
    };
    let of_base = common(before, after, is_base);
    tested(before, after, &of_base, named_each)
}

/// Compares the position of one target in the flange frame. Its number is `of_before` in the earlier session and `of_after` in the later
/// one. `None` if the two sessions have nothing in common.
pub fn compare_target(
    before: &Estimate,
    of_before: usize,
    after: &Estimate,
    of_after: usize,
) -> Option<Tested> {
    let after = after.with_exchanged_targets(of_before, of_after);
    let of_target = common(
        before,
        &after,
        |p| matches!(p, Parameter::Target(t, _) | Parameter::TargetRotation(t, _) if *t == of_before),
    );
    tested(before, &after, &of_target, named_each)
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

/// Names the changed parameters from the whitened difference.
type Naming = fn(&Whitened) -> Vec<Change>;

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
        naming(&whitened)
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

fn whitened(before: &Estimate, after: &Estimate, common: &[Common]) -> Option<Whitened> {
    if common.is_empty() {
        return None;
    }
    let reach_mm = before.model.reach_mm();
    let scale: Vec<f64> = common
        .iter()
        .map(|c| usual_error(c.parameter, reach_mm))
        .collect();
    let at_before: Vec<usize> = common.iter().map(|c| c.before).collect();
    let at_after: Vec<usize> = common.iter().map(|c| c.after).collect();
    let (u, v) = (&before.uncertainty, &after.uncertainty);
    // Prior knowledge that both sessions share: that of parameters with the same name, and of features if they are the same.
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
        rows(known.prior_gain(u, &known.before), &at_before),
        rows(known.prior_gain(v, &known.after), &at_after),
    );
    let prior_gain = square(&(&moved - &pulled));
    let effects = DMatrix::from_fn(common.len(), common.len(), |i, j| {
        v.shown(at_after[i], at_after[j]) * scale[j] / scale[i]
    });
    let unresolved =
        DMatrix::from_diagonal_element(common.len(), common.len(), RESOLUTION * RESOLUTION);
    let by_chance = &noise[0] + &noise[1] + prior_gain;
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
    // Satterthwaite (1946): the share of each part in the variance, averaged over the combinations.
    let n = n_combinations.max(1) as f64;
    let share = |part: &DMatrix<f64>| root.solve(part).trace() / n;
    let spread: f64 = [(&noise[0], u.freedom), (&noise[1], v.freedom)]
        .iter()
        .map(|(part, freedom)| share(part) * share(part) / freedom)
        .sum();
    Some(Whitened {
        difference: whiten(&difference)?.column(0).into(),
        parameters: common.iter().map(|c| c.parameter).collect(),
        effects: whiten(&effects)?,
        n_combinations,
        scale,
        freedom: 1.0 / spread.max(1.0 / MAX_FREEDOM),
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
const MAX_FREEDOM: f64 = 1e6;

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
        // Joints that follow others have no prior.
        let blocks = |of: &Estimate| {
            let Uncertainty {
                n_parameters,
                features,
                prior_std,
                ..
            } = &of.uncertainty;
            let first = n_parameters + features.followings.len();
            let n_higher = features.n_higher_harmonics(of.model.links.len());
            let usual = (first + n_higher).min(prior_std.len());
            [first..usual, usual..prior_std.len()]
        };
        let ([higher_u, usual_u], [higher_v, usual_v]) = (blocks(before), blocks(after));
        if u.features.has_same_higher_harmonics(&v.features) {
            pairs.extend(higher_u.zip(higher_v));
        }
        if u.features.has_same_usual_sources(&v.features) {
            pairs.extend(usual_u.zip(usual_v));
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

    /// C·P⁻¹·S: effect of an error of each prior, by one standard deviation, on the most probable values of a session.
    fn prior_gain(&self, of: &Uncertainty, at: &[usize]) -> DMatrix<f64> {
        let covariance = of.covariance();
        DMatrix::from_fn(covariance.nrows(), at.len(), |i, k| {
            let own = of.prior_std[at[k]];
            covariance[(i, at[k])] * self.std[k] / (own * own)
        })
    }
}
