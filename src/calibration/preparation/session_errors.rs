//! Errors over a session: play of joints, errors that the points of a visit share, and drift.

use crate::calibration::preparation::all_fit::AllFit;
use crate::calibration::preparation::observe::Observed;
use crate::identification::screening::backlash::Backlash;
use crate::identification::screening::drift::Drift;
use crate::identification::screening::row_order::InOrder;
use crate::identification::screening::settling::SharedErrors;
use crate::solvers::watch::Watch;

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
    let points = || order.iter().map(|p| &observed.all[*p]);
    let points = InOrder {
        linear: fit.linear.of(order),
        features: fit.features.select_rows(&rows),
        joints: order.iter().map(|p| fit.columns.joints(*p)).collect(),
        shifts: order.iter().map(|p| fit.columns.base_shift(*p)).collect(),
        roots: points().map(|o| o.weight.sqrt()).collect(),
        q_rad: points().map(|o| o.q_rad.as_slice()).collect(),
        clusters: order.iter().map(|p| all_clusters[*p]).collect(),
        targets: points().map(|o| o.target).collect(),
        reach_mm: fit.reach_mm,
        watch,
    };
    let play = points.backlash();
    let beside_play = InOrder {
        linear: points.linear.with(&play.columns),
        ..points
    };
    let (shared, drift) = (beside_play.shared_errors(), beside_play.drift());
    SessionErrors {
        // a drift is a shift of each visit, too
        shared: shared.filter(|shared| shared.joints_rad.is_some() || drift.is_none()),
        drift,
        backlash: play.backlash,
    }
}
