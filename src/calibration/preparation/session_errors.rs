//! Errors over a session: play of joints, errors that the points of a visit share, and drift.

use crate::calibration::preparation::all_fit::AllFit;
use crate::calibration::preparation::observe::Observed;
use crate::identification::screening::backlash::{Approaches, Backlash};
use crate::identification::screening::drift::{Drift, Session};
use crate::identification::screening::settling::{SharedErrors, Visits};
use crate::solvers::watch::Watch;
use nalgebra::{Matrix3, Matrix3xX};

/// Errors over a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionErrors {
    /// Play of joints.
    pub backlash: Vec<Backlash>,
    /// Errors that the points of one visit share.
    pub shared: Option<SharedErrors>,
    /// Drift common to all points.
    pub drift: Option<Drift>,
}

/// Errors of the given points, in measuring order. A drift is looked for beside the play: poses that were approached from below first and from above
/// at the end would look like one.
pub(super) fn session_errors(
    observed: &Observed,
    fit: &AllFit,
    order: &[usize],
    watch: &Watch<'_>,
) -> SessionErrors {
    let rows: Vec<usize> = order.iter().flat_map(|p| 3 * p..3 * p + 3).collect();
    let all_clusters = observed.all_clusters();
    let clusters: Vec<usize> = order.iter().map(|p| all_clusters[*p]).collect();
    let targets: Vec<usize> = order.iter().map(|p| observed.all[*p].target).collect();
    let joints: Vec<&Matrix3xX<f64>> = order.iter().map(|p| fit.columns.joints(*p)).collect();
    let q_rad: Vec<&[f64]> = order
        .iter()
        .map(|p| observed.all[*p].q_rad.as_slice())
        .collect();
    let (linear, features) = (fit.linear.of(order), fit.features.select_rows(&rows));
    let play = Approaches {
        linear: &linear,
        features: &features,
        joints: &joints,
        q_rad: &q_rad,
        clusters: &clusters,
        targets: &targets,
        reach_mm: fit.reach_mm,
        watch,
    }
    .backlash();
    let shifts: Vec<Matrix3<f64>> = order.iter().map(|p| fit.columns.base_shift(*p)).collect();
    let visits = Visits {
        linear: &linear.with(&play.columns),
        features: &features,
        joints: &joints,
        shifts: &shifts,
        clusters: &clusters,
        reach_mm: fit.reach_mm,
        watch,
    };
    let shared = visits.shared_errors();
    let session = Session {
        linear: visits.linear,
        features: &features,
        roots: &order
            .iter()
            .map(|p| observed.all[*p].weight.sqrt())
            .collect::<Vec<_>>(),
        q_rad: &q_rad,
        clusters: &clusters,
        targets: &targets,
        watch,
    };
    let drift = session.drift();
    SessionErrors {
        // a drift is a shift of each visit, too
        shared: shared.filter(|shared| shared.joints_rad.is_some() || drift.is_none()),
        drift,
        backlash: play.backlash,
    }
}
