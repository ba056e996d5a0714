//! Gross errors: isolated rows with a large deviation. They are found before any other search.

use crate::calibration::Error;
use crate::calibration::preparation::all_fit::{AllFit, fit_all};
use crate::calibration::preparation::arrangement::Arrangement;
use crate::calibration::preparation::observe::Observed;
use crate::calibration::request::CalibrationRequest;
use crate::identification::screening::outliers::Outliers;
use crate::solvers::median::median;
use crate::solvers::watch::Watch;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of outlier searches. Each uses the fit without the gross errors found so far.
pub(super) const MAX_SEARCHES: usize = 4;

/// A run of fewer outlying rows of a target consists of gross errors. A run of this many or more may be a target that moved.
const MIN_MOVED: usize = 3;
/// An isolated row that deviates by more than this share of the reach is a gross error, not a motion: 8 mm on an arm of 1.7 m.
const GROSS_PER_REACH: f64 = 5e-3;
/// In a segment of suspects, an outlier deviates by more than this multiple of the median.
const MIN_TIMES_MEDIAN: f64 = 2.0;

/// The fit to all points except the gross errors.
pub(super) struct WithoutGross {
    /// The gross errors: isolated rows that are off by more than [`GROSS_PER_REACH`].
    pub gross: Vec<usize>,
    pub fit: AllFit,
    /// All outliers, including the gross errors.
    pub outliers: Option<Outliers>,
}

/// Finds the gross errors and fits without them. Rows that are off by metres move the fit so far that the linearisation is invalid and real motions
/// stay hidden. The search is repeated from each new fit until the gross errors no longer change.
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
        let outliers = fit.outliers(watch);
        let limit_mm = GROSS_PER_REACH * fit.reach_mm;
        let known: BTreeSet<usize> = gross.iter().copied().collect();
        let rest = arrangement.order.iter().filter(|p| !known.contains(p));
        let rest: Vec<usize> = rest.copied().collect();
        let lone = isolated_outliers(observed, &rest, outliers.as_ref(), MIN_MOVED);
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

/// Runs of suspects at the start or end of the file that cover at least two configurations of several targets. Such a run occurs if the
/// robot was hit.
fn outlying_together(
    observed: &Observed,
    order: &[usize],
    outliers: Option<&Outliers>,
) -> Vec<usize> {
    let n_targets = observed.targets.iter().max().map_or(1, |target| target + 1);
    // `points` is sorted in ascending order.
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

/// Suspects that are isolated among the points of their target, in measuring order, or that deviate by more than twice the median of their
/// segment. A reflector that slipped gives a whole segment of suspects with similar deviations, because the other reflectors determine the
/// fit. Such a segment is not returned, because outliers would hide the step.
pub(super) fn isolated_outliers(
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
            let Some(median) = median(segment.iter().filter_map(|p| sizes.get(p).copied())) else {
                continue;
            };
            let stands_out = |p: &usize| {
                segment.len() < shortest_segment
                    || sizes
                        .get(p)
                        .is_some_and(|size| *size > MIN_TIMES_MEDIAN * median)
            };
            lone.extend(segment.iter().copied().filter(stands_out));
        }
    }
    lone
}
