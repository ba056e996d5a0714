//! Selects the corrections that are kept, step by step: each must reduce the error of points that it was not fitted to.
//!
//! The points are divided into five parts that keep whole configurations together (by session if there are several). Each part is predicted by links
//! and corrections fitted to the other parts. The gain of a correction is the squared error without it minus that with it, averaged over
//! configurations. For a pose, its weighted rotation rows are included. A correction is kept if its gain exceeds the gain's standard error. The fits
//! to four parts are steps of the linear problem at the fit to all points. Both fits differ only by noise, and over such a difference the robot is
//! linear to a ten-thousandth.

use super::fit::{Fitted, Linear, Setting, fit};
use super::folds::{Evidence, Folds, Unseen, divisions};
use super::network::{FoldedResiduals, choose_network, train_network};
use super::{Term, corrections_at};
use crate::kinematics::compliance::{moments, rigid_chain};
use crate::kinematics::corrections::HARMONIC_ORDERS;
use crate::kinematics::{Corrections, ResidualNetwork};
use nalgebra::{DMatrix, DVector, Vector3};

/// All kept corrections together must gain by this number of standard errors, because each single one may have gained one standard error by
/// chance.
const STANDARD_ERRORS_TOGETHER: f64 = 2.0;
/// Minimum number of configurations for judging unseen ones.
const MIN_CONFIGURATIONS: usize = 10;

/// The selected corrections.
pub struct Selected {
    /// Links and corrections, without the network.
    pub fitted: Fitted,
    /// All corrections.
    pub corrections: Corrections,
    /// Corrections that were tried, in order.
    pub evidence: Vec<Evidence>,
}

/// Residuals of all points for each part that is left out of the fit. The points of that part are the unseen ones.
pub(super) fn residuals_by_fold(
    linear: &Linear,
    folds: &Folds,
    variance: f64,
) -> Option<Vec<DVector<f64>>> {
    let m = linear.columns.ncols();
    let normal = |fold: usize| {
        let rows: Vec<usize> = (0..folds.folds.len())
            .filter(|p| folds.folds[*p] == fold)
            .flat_map(|p| linear.rows_of(p))
            .collect();
        let (columns, residuals) = (
            linear.columns.select_rows(&rows),
            linear.residuals.select_rows(&rows),
        );
        (columns.tr_mul(&columns), columns.tr_mul(&residuals))
    };
    let normals: Vec<(DMatrix<f64>, DVector<f64>)> = (0..folds.n_folds).map(normal).collect();
    let left_out = |fold: usize| {
        let mut sum = (DMatrix::<f64>::zeros(m, m), DVector::<f64>::zeros(m));
        for (_, (normal, right)) in normals
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != fold)
        {
            sum.0 += normal;
            sum.1 += right;
        }
        let x = linear.solve(sum.0, sum.1, variance)?;
        Some(&linear.residuals - &linear.columns * x)
    };
    (0..folds.n_folds).map(left_out).collect()
}

/// Errors of unseen points, averaged over all divisions, and the residuals by part of the first division.
fn unseen(
    setting: &Setting<'_>,
    fitted: &Fitted,
    divisions: &[Folds],
) -> Option<(Unseen, Vec<DVector<f64>>)> {
    let linear = setting.linear(fitted);
    let (mut errors, mut first) = (vec![0.0; setting.observations.len()], None);
    for folds in divisions {
        let residuals = residuals_by_fold(&linear, folds, fitted.variance)?;
        for (point, error) in errors.iter_mut().enumerate() {
            let left = &residuals[folds.folds[point]];
            let squares: f64 = linear.rows_of(point).map(|row| left[row] * left[row]).sum();
            *error += squares / divisions.len() as f64;
        }
        first.get_or_insert(residuals);
    }
    Some((
        divisions.first()?.by_configuration(|point| errors[point]),
        first?,
    ))
}

/// Selects corrections for the robot of `links`, the fit of the links alone. `clusters` numbers each observation's configuration. `earlier` is the
/// robot's last residual network. `None` if there are too few points, or when `go_on` returns false.
pub fn select(
    setting: &Setting<'_>,
    links: &Fitted,
    clusters: &[usize],
    sessions: &[Option<String>],
    earlier: Option<&ResidualNetwork>,
    seed: u64,
    go_on: &mut dyn FnMut() -> bool,
) -> Option<Selected> {
    let divisions = divisions(clusters, sessions, seed);
    let folds = divisions
        .first()
        .filter(|folds| folds.n_clusters >= MIN_CONFIGURATIONS)?;
    let mut best = fit(setting, links, &[])?;
    let (mut error, mut residuals) = unseen(setting, &best, &divisions)?;
    let links_alone = error.clone();
    let mut evidence = Vec::new();
    for (kind, more) in kinds(setting, &best) {
        if !go_on() {
            return None;
        }
        let gives = best
            .terms
            .iter()
            .any(|t| matches!(t, Term::Joint(..) | Term::Base(_)));
        if more
            .iter()
            .any(|t| matches!(t, Term::Mass(_) | Term::FirstMoment(..)))
            && !gives
        {
            continue; // unobservable: no compliance carries these masses
        }
        let mut terms = best.terms.clone();
        terms.extend(more.iter().filter(|t| !best.terms.contains(t)));
        let Some(candidate) = fit(setting, &best, &terms) else {
            continue;
        };
        let Some((with, left)) = unseen(setting, &candidate, &divisions) else {
            continue;
        };
        let found = error.evidence(&with, &kind);
        if found.kept {
            (best, error, residuals) = (candidate, with, left);
        }
        evidence.push(found);
    }
    let mut corrections = setting.corrections(&best);
    let folded = FoldedResiduals {
        folds,
        residuals: &residuals,
        n_configurations: error.errors.len(),
    };
    if let Some(tried) = choose_network(setting, &best, &folded, earlier, seed, go_on) {
        corrections.residual = tried.network;
        if tried.evidence.kept {
            // The network was evaluated on the first division alone: its gain there is subtracted from the error over all divisions.
            let gains = tried
                .before
                .errors
                .iter()
                .zip(&tried.after.errors)
                .map(|(before, after)| before - after);
            error = Unseen {
                errors: error
                    .errors
                    .iter()
                    .zip(gains)
                    .map(|(left, gain)| left - gain)
                    .collect(),
            };
        }
        evidence.push(tried.evidence);
    }
    if evidence.iter().any(|e| e.kept) {
        let mut all = links_alone.evidence(&error, "all_together");
        all.kept = all.gain_mm2 > STANDARD_ERRORS_TOGETHER * all.standard_error_mm2;
        evidence.iter_mut().for_each(|e| e.kept &= all.kept);
        evidence.push(all);
    }
    Some(Selected {
        fitted: best,
        corrections,
        evidence,
    })
}

/// Fits the selected terms to the points of another setting, and a network if one was kept. `None` if the equations cannot be solved.
pub fn refit(
    setting: &Setting<'_>,
    selected: &Fitted,
    has_network: bool,
    earlier: Option<&ResidualNetwork>,
    seed: u64,
) -> Option<(Fitted, Corrections)> {
    let fitted = fit(setting, selected, &selected.terms)?;
    let mut corrections = setting.corrections(&fitted);
    if has_network {
        corrections.residual = Some(train_network(setting, &fitted, earlier, seed)?);
    }
    Some((fitted, corrections))
}

/// The corrections in the order in which they are tried, with the terms that each adds.
fn kinds(setting: &Setting<'_>, links: &Fitted) -> Vec<(String, Vec<Term>)> {
    let n = setting.nominal.links.len();
    let gravity = [Term::Gravity(0), Term::Gravity(1)];
    let giving = |terms: Vec<Term>| -> Vec<Term> { terms.into_iter().chain(gravity).collect() };
    let loaded = most_loaded(setting, links);
    let names: Vec<String> = loaded.iter().map(|joint| (joint + 1).to_string()).collect();
    let axes = |of: fn(usize, usize) -> Term, links: std::ops::Range<usize>| -> Vec<Term> {
        links
            .flat_map(|link| (0..3).map(move |axis| of(link, axis)))
            .collect()
    };
    let phases = |joint| {
        (0..HARMONIC_ORDERS)
            .flat_map(move |order| (0..2).map(move |phase| Term::Harmonic(joint, order, phase)))
    };
    vec![
        (
            format!("stiffness_{}", names.join("_")),
            giving(loaded.iter().map(|joint| Term::Joint(*joint, 2)).collect()),
        ),
        ("stiffness_all".into(), giving(axes(Term::Joint, 0..n))),
        (
            "base_compliance".into(),
            giving((0..3).map(Term::Base).collect()),
        ),
        ("link_masses".into(), (1..n).map(Term::Mass).collect()),
        ("link_centres".into(), axes(Term::FirstMoment, 1..n)),
        ("joint_harmonics".into(), (0..n).flat_map(phases).collect()),
    ]
}

/// The two joints with the largest gravity moment about their axes: 2 and 3 of an arm on a floor.
fn most_loaded(setting: &Setting<'_>, links: &Fitted) -> Vec<usize> {
    let n = links.model.links.len();
    let none = corrections_at(n, &setting.mounting, &[], &[]);
    let mut load = vec![0.0; n];
    for o in setting.observations {
        let moments: Vec<Vector3<f64>> =
            moments(&rigid_chain(&links.model.links, &o.q_rad), &none.compliance).joints;
        load.iter_mut()
            .zip(moments)
            .for_each(|(sum, moment)| *sum += moment.z * moment.z);
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| load[*b].total_cmp(&load[*a]).then(a.cmp(b)));
    order.truncate(2);
    order.sort_unstable();
    order
}
