//! Gross errors: rows that stand alone and are far off. They are found before anything else is searched for.

use crate::calibration::Error;
use crate::calibration::preparation::all_fit::{AllFit, fit_all};
use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::request::CalibrationRequest;
use crate::identification::outliers::Outliers;
use crate::solvers::watch::Watch;
use std::collections::{BTreeMap, BTreeSet};

/// Searches for outliers at most, each from the fit without those found before.
pub(super) const MAX_SEARCHES: usize = 4;

/// A run of fewer far rows of a target is gross errors. A run of this many may be a target that moved.
const FEWEST_MOVED: usize = 3;
/// A row that stands alone and is this share of the reach from where the others put it is a gross error, not something that moved: 8 mm on an arm of
/// 1.7 m.
const GROSS_PER_REACH: f64 = 5e-3;
/// An outlier in a segment of suspects is this many times as far off as half of them.
const STANDS_OUT: f64 = 2.0;

/// All points fitted but the gross errors.
pub(super) struct WithoutGross {
    /// The gross errors: rows that stand alone and are off by more than [`GROSS_PER_REACH`].
    pub gross: Vec<usize>,
    pub fit: AllFit,
    /// All outliers, the gross errors among them.
    pub outliers: Option<Outliers>,
}

/// Rows that are off by metres pull the fit so far that the problem is linear about the wrong place, and hide there what moved. They are left out before
/// anything is searched for, again from each fit without those found.
pub(super) fn without_gross(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    watch: &Watch<'_>,
) -> Result<WithoutGross, Error> {
    let mut gross: Vec<usize> = Vec::new();
    let mut n_searches = 0;
    loop {
        let fit = fit_all(request, observed, arrangement, &gross, watch)?;
        let outliers = fit.linear.outliers(fit.least_scale_mm, watch);
        let limit_mm = GROSS_PER_REACH * fit.reach_mm;
        let known: BTreeSet<usize> = gross.iter().copied().collect();
        let rest = arrangement.order.iter().filter(|p| !known.contains(p));
        let rest: Vec<usize> = rest.copied().collect();
        let lone = lone_suspects(observed, &rest, outliers.as_ref(), FEWEST_MOVED);
        let lone: BTreeSet<usize> = lone.into_iter().collect();
        let together = outlying_together(observed, &rest, outliers.as_ref());
        let together: BTreeSet<usize> = together.into_iter().collect();
        let is_alone = |point: &usize| {
            known.contains(point) || (lone.contains(point) && !together.contains(point))
        };
        let sizes = outliers
            .iter()
            .flat_map(|w| w.points.iter().zip(&w.sizes_mm));
        let found: Vec<usize> = sizes
            .filter(|(point, size_mm)| {
                let weight = observed.all[**point].weight;
                is_alone(point) && **size_mm > limit_mm * weight.sqrt()
            })
            .map(|(point, _)| *point)
            .collect();
        n_searches += 1;
        if found == gross || n_searches == MAX_SEARCHES || watch.was_stopped() {
            return Ok(WithoutGross {
                gross,
                fit,
                outliers,
            });
        }
        gross = found;
    }
}

/// Suspects in a row at an end of the file that are all points of two configurations or more with several targets: what was knocked moves like that.
fn outlying_together(
    observed: &Observed,
    order: &[usize],
    outliers: Option<&Outliers>,
) -> Vec<usize> {
    let n_targets = observed.targets.iter().max().map_or(1, |target| target + 1);
    // ascending
    let is_suspect =
        |p: &usize| outliers.is_some_and(|found| found.points.binary_search(p).is_ok());
    let runs = order.chunk_by(|a, b| is_suspect(a) == is_suspect(b));
    let is_at_end = |run: &&[usize]| run.first() == order.first() || run.last() == order.last();
    runs.filter(|run| n_targets > 1 && run.len() >= 2 * n_targets && is_suspect(&run[0]))
        .filter(is_at_end)
        .flatten()
        .copied()
        .collect()
}

/// The suspects that stand alone among the points of their target, in measuring order, or out of the segment that they stand in: twice as
/// far off as half of it. A reflector that slipped makes a segment of suspects, where the other reflectors hold the fit, and all by as much; a
/// outlier would hide the step.
pub(super) fn lone_suspects(
    observed: &Observed,
    order: &[usize],
    outliers: Option<&Outliers>,
    shortest_segment: usize,
) -> Vec<usize> {
    let sizes: BTreeMap<usize, f64> = outliers
        .iter()
        .flat_map(|w| w.points.iter().copied().zip(w.sizes_mm.iter().copied()))
        .collect();
    let mut lone = Vec::new();
    for target in 0..observed
        .targets
        .iter()
        .map(|target| target + 1)
        .max()
        .unwrap_or(0)
    {
        let is_of_target = |p: &&usize| observed.targets[**p] == target;
        let of_target: Vec<usize> = order.iter().filter(is_of_target).copied().collect();
        for segment in of_target.chunk_by(|a, b| sizes.contains_key(a) == sizes.contains_key(b)) {
            let mut by_size: Vec<f64> = segment
                .iter()
                .filter_map(|p| sizes.get(p).copied())
                .collect();
            by_size.sort_by(f64::total_cmp);
            let Some(median) = by_size.get(by_size.len() / 2) else {
                continue;
            };
            let stands_out = |p: &usize| {
                segment.len() < shortest_segment
                    || sizes.get(p).is_some_and(|size| *size > STANDS_OUT * median)
            };
            lone.extend(segment.iter().copied().filter(stands_out));
        }
    }
    lone
}
