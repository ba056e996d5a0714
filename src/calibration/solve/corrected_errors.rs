//! Errors of the links and corrections that are delivered.

use crate::calibration::outcome::delivery::delivered;
use crate::calibration::outcome::stated_uncertainty::misfit;
use crate::calibration::preparation::loss::PointLoss;
use crate::calibration::problem::Problem;
use crate::calibration::solve::corrections::{Points, setting};
use crate::identification::KinematicModel;
use crate::identification::corrections::Fitted;
use crate::identification::statistics::estimate::CorrectedErrors;
use crate::identification::statistics::uncertainty::{FittedCorrections, Session, uncertainty};

use crate::solvers::watch::Watch;

/// Errors of the corrections that were fitted to the points of a problem. `links_alone` is its fit without corrections. `None` where the wider problem
/// is not that of this fit: with a robust loss, whose pseudo-points are those of the links alone, with the frames of sweeps, and if the equations cannot
/// be solved.
pub fn corrected_errors(
    problem: &Problem<'_>,
    links_alone: &KinematicModel,
    fitted: &Fitted,
    watch: &Watch<'_>,
) -> Option<CorrectedErrors> {
    if problem.loss != PointLoss::Squares || problem.request.frames.is_some() {
        return None;
    }
    let points = Points::new(problem, links_alone);
    let nominal = delivered(problem, &problem.nominal);
    let setting = setting(problem, &nominal, &[], &points);
    let placed = setting.placed(fitted);
    let of_links = problem.rows(&points.observations, &[]);
    let rows = problem.rows(&placed, &[]);
    let stations = match points.set_ups.is_empty() {
        true => vec![None; placed.len()],
        false => points.set_ups.clone(),
    };
    let found = uncertainty(Session {
        model: &fitted.model,
        problem: &rows,
        observations: &placed,
        configurations: &points.clusters,
        stations: &stations,
        corrections: Some(FittedCorrections {
            corrections: setting.corrections(fitted),
            mounting: setting.mounting,
            widths: setting.widths(&fitted.terms),
            fitted,
            links_alone: (links_alone, &of_links),
        }),
        misfit: misfit(problem),
        watch,
    })?;
    Some(CorrectedErrors {
        terms: fitted.terms.clone(),
        mounting: setting.mounting,
        uncertainty: found,
    })
}
