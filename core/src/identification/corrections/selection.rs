//! Selects the corrections that are kept, step by step: each must reduce the error of points that it was not fitted to.
//!
//! The points are divided into five parts that keep whole configurations together (by session if there are several). Each part is predicted by links
//! and corrections fitted to the other parts. The gain of a correction is the squared error without it minus that with it, averaged over
//! configurations. For a pose, its weighted rotation rows are included. A correction is kept if its gain exceeds twice the gain's standard error.
//! A fit to four parts is approximated by one linear step from the fit to all points. The two fits differ only by noise, and over such a difference
//! the robot is linear to a ten-thousandth.
//!
//! In these fits the priors of the corrections have their usual widths. Widths that follow from all points would let the points of a part
//! influence the fit that has to predict them. (The noise and the widths of the links do follow from all points; they are the same for all parts.)
//! The delivered fit takes its widths from all points.

use super::fit::{Fit, Fitted, Setting};
use super::folds::{Evidence, Folds, Unseen, divisions};
use super::network::{FoldedResiduals, choose_network, train_network};
use crate::identification::least_squares::evidence::{self, Triangle};
use crate::identification::least_squares::problem::CorrectionWidths;
use crate::identification::model::correction_terms::Term;
use crate::kinematics::corrections::HARMONIC_ORDERS;
use crate::kinematics::{Corrections, ResidualNetwork};

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
fn residuals_by_fold(fit: &Fit<'_>, folds: &Folds) -> Vec<Vec<f64>> {
    let (problem, estimate) = (&fit.problem, &fit.estimate);
    let of_fold = |fold: usize| {
        let points = (0..folds.folds.len()).filter(move |p| folds.folds[*p] == fold);
        Triangle::at(&problem.part(points), &estimate.x)
    };
    let triangles: Vec<Triangle> = (0..folds.n_folds).map(of_fold).collect();
    let left_out = |fold: usize| {
        let others = triangles.iter().enumerate().filter(|(k, _)| *k != fold);
        let seen = Triangle::of_all(others.map(|(_, t)| t)).with_flat_at(&estimate.x);
        let posterior = seen.solve(&estimate.x, &estimate.evidence);
        let mut step = posterior.step.clone();
        // A station or a target all of whose points are left out is placed on them, as a new session is.
        let without_points = seen.undetermined(&posterior);
        if !without_points.is_empty() {
            let left_out = triangles[fold].clone().with_flat_at(&estimate.x);
            let of_placement = left_out.moved(&step).of_columns(&without_points);
            let pick = |all: &[f64]| without_points.iter().map(|j| all[*j]).collect::<Vec<f64>>();
            let evidence = evidence::Evidence {
                widths: pick(&estimate.evidence.widths),
                ..estimate.evidence.clone()
            };
            let placed = of_placement.solve(&pick(&estimate.x), &evidence);
            for (j, more) in without_points.iter().zip(&placed.step) {
                step[*j] += more;
            }
        }
        let at = estimate.x.iter().zip(&step);
        let at: Vec<f64> = at.map(|(x, step)| x + step).collect();
        let mut residuals = vec![0.0; problem.n_rows()];
        problem.evaluate(&at, &mut residuals, None);
        residuals
    };
    (0..folds.n_folds).map(left_out).collect()
}

/// Errors of unseen points, averaged over all divisions, and the residuals by part of the first division.
fn unseen(fit: &Fit<'_>, divisions: &[Folds]) -> Option<(Unseen, Vec<Vec<f64>>)> {
    let problem = &fit.problem;
    let (mut errors, mut first) = (vec![0.0; problem.n_blocks()], None);
    for folds in divisions {
        let residuals = residuals_by_fold(fit, folds);
        for (point, error) in errors.iter_mut().enumerate() {
            let left = &residuals[folds.folds[point]][problem.rows_of(point)];
            *error += left.iter().map(|v| v * v).sum::<f64>() / divisions.len() as f64;
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
    let usual = CorrectionWidths::Usual;
    let mut best = setting.fit(links, &[], usual, go_on)?;
    let (mut error, mut residuals) = unseen(&best, &divisions)?;
    let mut tried = Vec::new();
    for (kind, more) in kinds(setting.links.reference.links.len()) {
        let at = best.fitted();
        // Masses are seen only through a compliance.
        let is_compliant = |term: &Term| matches!(term, Term::Joint(..) | Term::Base(_));
        if kind == LINK_MASSES && !at.terms.iter().any(is_compliant) {
            continue;
        }
        let terms = [at.terms.clone(), more].concat();
        let candidate = setting.fit(&at, &terms, usual, go_on);
        if !go_on() {
            return None;
        }
        let Some(candidate) = candidate else { continue };
        let Some((with, left)) = unseen(&candidate, &divisions) else {
            continue;
        };
        let found = error.evidence(&with, kind);
        if found.kept {
            (best, error, residuals) = (candidate, with, left);
        }
        tried.push(found);
    }
    let folded = FoldedResiduals {
        folds,
        residuals: &residuals,
        n_configurations: error.errors.len(),
    };
    let at = best.fitted();
    let delivered = match at.terms.is_empty() {
        true => best,
        false => setting.fit(&at, &at.terms, CorrectionWidths::ByEvidence, go_on)?,
    };
    let mut corrections = delivered.corrections()?;
    if let Some(of_network) = choose_network(setting, &delivered, &folded, earlier, seed, go_on) {
        corrections.residual = of_network.network;
        tried.push(of_network.evidence);
    }
    Some(Selected {
        fitted: delivered.fitted(),
        corrections,
        evidence: tried,
    })
}

/// Fits the selected terms to the points of another setting, and a network if one was kept. `None` if the equations cannot be solved. If `go_on`
/// returns false, the fit ends early.
pub fn refit(
    setting: &Setting<'_>,
    selected: &Fitted,
    has_network: bool,
    earlier: Option<&ResidualNetwork>,
    seed: u64,
    go_on: &mut dyn FnMut() -> bool,
) -> Option<(Fitted, Corrections)> {
    let fit = setting.fit(
        selected,
        &selected.terms,
        CorrectionWidths::ByEvidence,
        go_on,
    )?;
    let mut corrections = fit.corrections()?;
    if has_network {
        corrections.residual = Some(train_network(setting, &fit, earlier, seed)?);
    }
    Some((fit.fitted(), corrections))
}

/// Joints and base deflect under gravity.
pub const COMPLIANCE: &str = "compliance";
/// Masses and centres of gravity of the links.
const LINK_MASSES: &str = "link_masses";

/// The corrections of an arm of `n` links, in the order in which they are tried, with the terms that each adds.
fn kinds(n: usize) -> [(&'static str, Vec<Term>); 4] {
    let joints = (0..n).flat_map(|joint| (0..3).map(move |axis| Term::Joint(joint, axis)));
    let couplings = (0..n).flat_map(|joint| (0..n).map(move |other| Term::Coupling(joint, other)));
    // The weight of the first link is carried by the base.
    let moments = (1..n).flat_map(|link| (0..3).map(move |axis| Term::FirstMoment(link, axis)));
    let harmonic = |joint| {
        (0..HARMONIC_ORDERS)
            .flat_map(move |order| (0..2).map(move |phase| Term::Harmonic(joint, order, phase)))
    };
    let of_gravity = joints
        .chain((0..3).map(Term::Base))
        .chain((0..2).map(Term::Gravity));
    [
        (COMPLIANCE, of_gravity.collect()),
        ("joint_coupling", couplings.collect()),
        (LINK_MASSES, (1..n).map(Term::Mass).chain(moments).collect()),
        ("joint_harmonics", (0..n).flat_map(harmonic).collect()),
    ]
}
