//! Errors that the points of one visit share: the arm was not where its joint values say, or the instrument had an error.
//!
//! A visit is a run of points of one configuration, measured one after another. Its points share an error J·δ, with J the effects of the
//! joints and δ random errors of the joint values; or they share one vector. Both are random effects in addition to the robot's misfit. The
//! more likely one is reported on two conditions: noise gives as large an effect with a probability below [`FALSE_ALARMS`], and the shared
//! error is larger than the error of each single point and than a robot's repeatability. Further points of a visit are then useless.
//!
//! A rotation by δ moves targets differently, so the scatter about the means of visits is not the noise of a point. The random effect
//! separates the two.

use crate::identification::screening::row_order::{OrderedPoints, visits};
use crate::identification::screening::whitening::Whitener;
use crate::identification::statistics::variance::{RandomEffect, misfit_ratio, random_effect};
use nalgebra::DMatrix;

/// Probability of reporting shared errors if there are none.
const FALSE_ALARMS: f64 = 0.002;
/// Number of random effects that share this probability.
const N_TESTS: f64 = 2.0;
/// Maximum number of visits that are used, evenly selected.
const MAX_VISITS: usize = 40;
/// Maximum number of points of a visit that are used, evenly selected: its mean is then known well enough compared with the spread of the
/// visits.
const MAX_OF_VISIT: usize = 25;
/// Repeatability of robots: standard deviation of a coordinate, as a share of the reach. Makers state repeatabilities of up to 1e-4 of the
/// reach. By ISO 9283, the stated value is the mean distance plus three of its standard deviations, which is 3.6 standard deviations of a
/// coordinate.
pub(super) const REPEATABILITY_PER_REACH: f64 = 1e-4 / 3.6;

/// Errors that the points of one visit share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedErrors {
    /// Standard deviation per coordinate of the shared error, mm.
    pub shared_mm: f64,
    /// Standard deviation per coordinate of the error that is independent from point to point, mm.
    pub own_mm: f64,
    /// Standard deviation of each joint value that explains them, rad; `None` if one vector per visit explains them better.
    pub joints_rad: Option<f64>,
}

/// Random effects of the visits: the columns of each visit are 0 at the points of the others.
fn of_visits<'a>(
    visits: &[Vec<usize>],
    n_columns: usize,
    effect: impl Fn(usize) -> nalgebra::DMatrixView<'a, f64>,
) -> DMatrix<f64> {
    let n_points = visits.iter().map(Vec::len).sum::<usize>();
    let mut columns = DMatrix::zeros(3 * n_points, n_columns * visits.len());
    let mut row = 0;
    for (k, visit) in visits.iter().enumerate() {
        for point in visit {
            columns
                .view_mut((row, n_columns * k), (3, n_columns))
                .copy_from(&effect(*point));
            row += 3;
        }
    }
    columns
}

impl OrderedPoints<'_> {
    /// The errors that points of one visit share; `None` if none are significant and large.
    pub fn shared_errors(&self) -> Option<SharedErrors> {
        let several = visits(&self.clusters).into_iter().filter(|v| v.len() > 1);
        let several: Vec<Vec<usize>> = several.collect();
        let every = several.len().div_ceil(MAX_VISITS).max(1);
        let thinned = |visit: Vec<usize>| -> Vec<usize> {
            let every = visit.len().div_ceil(MAX_OF_VISIT);
            visit.into_iter().step_by(every).collect()
        };
        let visits = several.into_iter().step_by(every).map(thinned);
        let visits: Vec<Vec<usize>> = visits.collect();
        let points: Vec<usize> = visits.concat();
        let n_joints = self.joints.first()?.ncols();
        if points.is_empty() || !self.watch.goes_on() {
            return None;
        }
        let Self {
            linear, features, ..
        } = self.of(&points);
        let misfit = misfit_ratio(&linear.residuals, &linear.basis, &features);
        let whitener = Whitener::new(&features, misfit)?;
        let q = whitener.whitened(&linear.basis).qr().q();
        let y = whitener.whitened_column(&linear.residuals);
        let effect = |columns: &DMatrix<f64>| {
            self.watch.goes_on().then_some(())?;
            random_effect(&y, &q, &whitener.whitened(columns))
        };
        let joints = of_visits(&visits, n_joints, |i| self.joints[i].as_view());
        let shifts = of_visits(&visits, 3, |i| self.shifts[i].as_view());
        let by_joints = effect(&joints)?;
        let by_shifts = effect(&shifts)?;
        let (found, columns, is_of_joints): (RandomEffect, DMatrix<f64>, bool) =
            match by_joints.likelihood_ratio > by_shifts.likelihood_ratio {
                true => (by_joints, joints, true),
                false => (by_shifts, shifts, false),
            };
        let std = (found.ratio * found.noise_variance).sqrt();
        let own_mm = found.noise_variance.sqrt();
        let shared_mm = std * columns.norm() / (3.0 * points.len() as f64).sqrt();
        let is_large = shared_mm > own_mm && shared_mm > REPEATABILITY_PER_REACH * self.reach_mm;
        (found.by_chance() <= FALSE_ALARMS / N_TESTS && is_large).then_some(SharedErrors {
            shared_mm,
            own_mm,
            joints_rad: is_of_joints.then_some(std),
        })
    }
}
