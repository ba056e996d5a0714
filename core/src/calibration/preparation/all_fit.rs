//! The fit to all points of an upload, with which screening starts, and the linear problem at its solution. It shows the errors over a
//! session: backlash of joints, errors that the points of a visit share, and drift.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::motions::{derivatives, fit_motions, parameters_of};
use crate::calibration::preparation::observe::{Observed, stated_scale_mm};
use crate::calibration::request::CalibrationRequest;
use crate::identification::least_squares::problem::reach_mm;
use crate::identification::model::objective::weighted_residuals;
use crate::identification::screening::backlash::Backlash;
use crate::identification::screening::columns::Columns;
use crate::identification::screening::drift::Drift;
use crate::identification::screening::outliers::{Linearised, Outliers, ROUNDING_PER_REACH};
use crate::identification::screening::row_order::OrderedPoints;
use crate::identification::screening::settling::SharedErrors;
use crate::identification::screening::whitening::Whitener;
use crate::identification::statistics::misfit::{Misfit, gravity_directions};
use crate::identification::statistics::variance::random_effect;
use crate::kinematics::Link;
use crate::solvers::watch::Watch;
use nalgebra::DMatrix;
use std::collections::BTreeSet;

/// A fit to all points, and the linear problem at its solution.
pub(super) struct AllFit {
    pub linear: Linearised,
    pub least_scale_mm: f64,
    /// Features of the robot's misfit, 3·N × m.
    pub features: DMatrix<f64>,
    pub columns: Columns,
    pub reach_mm: f64,
    /// The fitted links.
    pub links: Vec<Link>,
    /// The number of each point's configuration.
    configurations: Vec<usize>,
}

impl AllFit {
    /// The outliers; `None` if there are too few points to find any. If the points show a misfit, the misfit is fitted along with the
    /// links: links alone miss some poses of a robot with large sag, and sag hides other outliers.
    pub fn outliers(&self, watch: &Watch<'_>) -> Option<Outliers> {
        let found = self.linear.outliers(self.least_scale_mm, watch)?;
        Some(self.outliers_beside_misfit(&found, watch).unwrap_or(found))
    }

    /// The outliers if the misfit is fitted as well. `None` if no misfit is significant, or when the watch stops. The scatter remains that
    /// of the links alone, because losses use it as their scale.
    fn outliers_beside_misfit(&self, found: &Outliers, watch: &Watch<'_>) -> Option<Outliers> {
        let without = |left_out: &[usize]| -> Vec<usize> {
            let all = 0..self.linear.n_points();
            all.filter(|i| left_out.binary_search(i).is_err()).collect()
        };
        // The points with the largest sag may be among the outliers, and the others then show too little of it. The smaller outliers are
        // therefore kept. The largest one is left out, because a single point shows no misfit.
        let with_smaller_ones = || {
            let sizes = found.points.iter().zip(&found.sizes_mm);
            let (largest, _) = sizes.max_by(|a, b| a.1.total_cmp(b.1))?;
            (found.points.len() > 1).then(|| without(&[*largest]))
        };
        let ratio = self
            .misfit_ratio(&without(&found.points), watch)
            .or_else(|| self.misfit_ratio(&with_smaller_ones()?, watch))?;
        let whitener = watch
            .goes_on()
            .then(|| Whitener::new(&self.features, ratio))??;
        let expected = whitener.expected();
        let outliers = self
            .linear
            .outliers_beside(found, &expected, self.least_scale_mm, watch)?;
        Some(Outliers {
            scale_mm: found.scale_mm,
            ..outliers
        })
    }

    /// Ratio of the misfit's variance to that of the noise, from some of the points. `None` if it is not significant. Only one point of
    /// each configuration is used, because points of one configuration share errors, which would look like a misfit.
    fn misfit_ratio(&self, points: &[usize], watch: &Watch<'_>) -> Option<f64> {
        let mut seen = BTreeSet::new();
        let is_first = |point: &usize| seen.insert(self.configurations[*point]);
        let points: Vec<usize> = points.iter().copied().filter(is_first).collect();
        let rows: Vec<usize> = points.iter().flat_map(|p| 3 * p..3 * p + 3).collect();
        let linear = watch.goes_on().then(|| self.linear.of(&points))?;
        let features = self.features.select_rows(&rows);
        let misfit = random_effect(&linear.residuals, &linear.basis, &features)?;
        Some(misfit.kept_ratio()).filter(|ratio| *ratio > 0.0)
    }
}

/// Least squares on all points except `without`; the motions between set-ups are fitted too. Also returns the linear problem of all points.
pub(super) fn fit_all(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    without: &[usize],
    watch: &Watch<'_>,
) -> Result<AllFit, Error> {
    let weights: Vec<f64> = observed.all.iter().map(|o| o.weight).collect();
    without.iter().for_each(|p| observed.all[*p].weight = 0.0);
    let model = fit_motions(request, observed, arrangement, None, watch)?;
    let all = observed.all.iter_mut().zip(weights);
    all.for_each(|(o, weight)| o.weight = weight);
    arrangement.apply(observed);
    let parameters = parameters_of(request, &arrangement.fitted_targets(observed))?;
    let columns = Columns::new(&model, &observed.all);
    let derivatives = derivatives(&model, &parameters, &observed.all);
    watch.goes_on();
    let reach_mm = reach_mm(&model.links, observed.all.iter());
    let rounding_mm = ROUNDING_PER_REACH * reach_mm;
    let residuals = weighted_residuals(&model, &observed.all);
    let linear = Linearised::new(&residuals, derivatives, rounding_mm);
    watch.goes_on();
    let mounting = request.robot.mounting.as_ref();
    let misfit = Misfit {
        followings: vec![],
        gravity: gravity_directions(mounting.map(|m| &m.gravity_in_base)),
        harmonics: vec![1],
        held: vec![],
    };
    let poses = observed
        .all
        .iter()
        .map(|o| (o.q_rad.as_slice(), o.target, o.weight));
    let features = misfit.features(&model, poses);
    if !watch.goes_on() {
        return Err(Error::Cancelled);
    }
    Ok(AllFit {
        linear,
        columns,
        features,
        least_scale_mm: stated_scale_mm(&request.set).max(rounding_mm),
        reach_mm,
        links: model.links,
        configurations: request.set.configuration_numbers(),
    })
}

/// Errors over a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionErrors {
    /// Backlash of joints.
    pub backlash: Vec<Backlash>,
    /// Errors that the points of one visit share.
    pub shared: Option<SharedErrors>,
    /// Drift common to all points.
    pub drift: Option<Drift>,
}

/// Errors of the given points, in measuring order. Drift and backlash are fitted together: poses that were approached from below at first
/// and from above at the end would look like drift.
pub(super) fn session_errors(
    observed: &Observed,
    fit: &AllFit,
    order: &[usize],
    watch: &Watch<'_>,
) -> SessionErrors {
    let rows: Vec<usize> = order.iter().flat_map(|p| 3 * p..3 * p + 3).collect();
    let all_clusters = observed.all_clusters();
    let points = || order.iter().map(|p| &observed.all[*p]);
    let points = OrderedPoints {
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
    let beside_play = OrderedPoints {
        linear: points.linear.with(&play.columns),
        ..points
    };
    let (shared, drift) = (beside_play.shared_errors(), beside_play.drift());
    SessionErrors {
        // Drift also shifts each visit. Shifts of visits are therefore reported only if they have a component of the joints, or if there is
        // no drift.
        shared: shared.filter(|shared| shared.joints_rad.is_some() || drift.is_none()),
        drift,
        backlash: play.backlash,
    }
}
