//! Before anything is identified: which points do not belong, and did anything move while it was measured?
//!
//! Both are asked of all points of the upload, those to verify included: they are questions about the measurement. No parameter of the
//! robot is taken from the fits made here.

use crate::calibration::Error;
use crate::calibration::preparation::arrangement::{Arrangement, FittedTargets, motion};
use crate::calibration::preparation::motions::{
    derivatives, fit_motions, parameters_of, place_setups,
};
use crate::calibration::preparation::observe::{Observed, stated_scale_mm};
use crate::calibration::request::{CalibrationRequest, Loss, Model, Preset};
use crate::identification::misfit::{features, gravity_directions};
use crate::identification::objective::weighted_residuals;
use crate::identification::outliers::{Linearised, Outliers, ROUNDING_PER_REACH};
use crate::identification::problem::reach_mm;
use crate::identification::steps::{Campaign, Columns, Moved, Step, TargetShift, Whitened};
use crate::measurement::Subset;
use nalgebra::{DMatrix, Vector3};
use std::collections::BTreeMap;

/// Share of all points from which on a person has to look at the outliers.
const REVIEW_SHARE: f64 = 0.05;
/// Share of all points that may be left out of the fit.
const LEFT_OUT_SHARE: f64 = 0.1;
/// Fewer rows in a row that are far off are gross errors; as many may be those of a target that moved.
const FEWEST_MOVED: usize = 3;
/// Share of the points to identify that may be left out: by chance more outliers may be among these.
const LEFT_OUT_OF_SUBSET: f64 = 0.2;
/// A row that stands alone and is this share of the reach from where the others put it is a gross error, not something that moved: 8 mm on an arm of
/// 1.7 m.
const GROSS_PER_REACH: f64 = 5e-3;
/// An outlier in a segment of suspects is this many times as far off as half of them.
const STANDS_OUT: f64 = 2.0;
/// If this share of the points on the smaller side of a step is an outlier with it, it is no step: two or three outliers are explained by one
/// but for as many coordinates, and one of two, or two of three, stays an outlier.
const SCATTERED: f64 = 0.25;
/// Searches for outliers at most, each from the fit without those found before.
const MAX_SEARCHES: usize = 4;
/// Steps at most; a campaign with more is not worth fitting.
const MAX_STEPS: usize = 4;

/// A point that does not belong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// 0-based data row.
    pub row: usize,
    /// How far it lies from where the others put it, mm.
    pub size_mm: f64,
}

/// What moved in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WhatMoved {
    /// A target on the flange.
    Target(usize),
    /// The base, or the instrument.
    Base,
}

/// Something that moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundStep {
    /// What.
    pub moved: WhatMoved,
    /// First data row after it.
    pub row: usize,
    /// By how much: a target in the flange frame, the base (and the instrument the other way) in the measuring frame, mm.
    pub vector_mm: Vector3<f64>,
    /// Turn of the base, rad.
    pub turn_rad: Vector3<f64>,
    /// One point alone at an end: it may as well be an outlier, and is treated so.
    pub is_one_point: bool,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Screening {
    /// Points that do not belong, by row.
    pub outliers: Vec<Outlier>,
    /// Standard deviation of one coordinate of the others, mm.
    pub scale_mm: f64,
    /// The outliers are few enough to be left out, and the loss is ours to choose: those to identify count nothing.
    pub is_down_weighted: bool,
    /// So many points are outliers that a person has to look.
    pub is_for_review: bool,
    /// The outliers are few enough not to count in comparisons.
    pub are_few: bool,
    /// Steps, by row.
    pub steps: Vec<FoundStep>,
    /// Rows of segments without identify points: they are scored with the segment before.
    pub unfitted_rows: Vec<usize>,
    /// The targets of the fit.
    pub targets: FittedTargets,
}

/// A fit to all points, and the linear problem there.
struct AllFit {
    linear: Linearised,
    least_scale_mm: f64,
    /// What the misfit of a robot looks like, 3·N × m.
    features: DMatrix<f64>,
    columns: Columns,
    reach_mm: f64,
}

impl Screening {
    /// Rows that do not count in comparisons.
    pub fn rows_left_out(&self) -> impl Iterator<Item = usize> {
        let counted_out = self.outliers.iter().filter(|_| self.are_few);
        counted_out.map(|outlier| outlier.row)
    }
}

/// Screens the points, and arranges them for the fit: outliers lose their weight, what moved is taken apart.
pub fn screen(
    request: &CalibrationRequest,
    observed: &mut Observed,
) -> Result<(Screening, Arrangement), Error> {
    let mut arrangement = Arrangement::of(request);
    let mut screening = Screening::default();
    place_setups(request, observed, &mut arrangement)?;
    if request.preset == Preset::Default {
        let mut outliers = search(request, observed, &mut arrangement, &mut screening)?;
        for _ in 0..MAX_SEARCHES {
            let again = search_again(request, observed, &mut arrangement, outliers.as_ref())?;
            let same =
                |again: &Outliers| outliers.as_ref().is_some_and(|w| w.points == again.points);
            if again.as_ref().is_none_or(same) {
                break;
            }
            outliers = again;
        }
        screening.unfitted_rows = arrangement.join_unfitted(observed);
        if let Some(outliers) = outliers {
            leave_out(request, observed, &mut screening, &outliers);
        }
    }
    fit_motions(request, observed, &mut arrangement, Some(Subset::Identify))?;
    arrangement.apply(observed);
    screening.targets = arrangement.fitted_targets(observed);
    Ok((screening, arrangement))
}

/// Finds steps one after another, and what is an outlier beside them.
fn search(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    screening: &mut Screening,
) -> Result<Option<Outliers>, Error> {
    let WithoutGross {
        gross,
        mut fit,
        mut outliers,
    } = without_gross(request, observed, arrangement)?;
    let others = |points: &[usize], left_out: &[usize]| -> Vec<usize> {
        let is_other = |p: &&usize| !left_out.contains(p);
        points.iter().filter(is_other).copied().collect()
    };
    while screening.steps.len() < MAX_STEPS {
        let suspects = outliers
            .as_ref()
            .map_or(vec![], |w| others(&w.points, &gross));
        let order = others(&arrangement.order, &gross);
        let belonging = others(&order, &suspects);
        let with_all = find(observed, &fit, &order);
        let lone = lone_suspects(observed, &order, outliers.as_ref(), 2);
        let without_lone = (!lone.is_empty() && lone.len() < suspects.len())
            .then(|| find(observed, &fit, &others(&order, &lone)));
        let without = if suspects.is_empty() {
            None
        } else {
            find(observed, &fit, &belonging)
        };
        let mut accepted = false;
        // with outliers in the fit, a step has to explain some of them; with segments of them, at least half of these
        let in_segments = suspects.len() - lone.len();
        let tried = [
            (&with_all, suspects.len().min(1)),
            (&without_lone.flatten(), in_segments.div_ceil(2)),
            (&without, 0),
        ];
        for (step, n_to_explain) in tried {
            let Some(step) = step.as_ref().filter(|s| s.n_minor > 1) else {
                continue;
            };
            let mut trial = split(observed, &fit, arrangement, step);
            let refit = fit_all(request, observed, &mut trial, &gross)?;
            let left = refit.linear.outliers(refit.least_scale_mm);
            let n_left = left.as_ref().map(|w| others(&w.points, &gross).len());
            if n_left.is_some_and(|n| n_to_explain > 0 && n + n_to_explain > suspects.len()) {
                continue;
            }
            // what moved takes its points along: where many of them stay outliers, they are no segment
            let minor = others(&minor_side(observed, arrangement, step), &gross);
            let still_outlying = left
                .as_ref()
                .map_or(0, |w| minor.iter().filter(|p| w.points.contains(p)).count());
            if still_outlying as f64 >= SCATTERED * minor.len() as f64 {
                continue;
            }
            screening.steps.extend(found(step, false));
            (*arrangement, fit, outliers, accepted) = (trial, refit, left, true);
            break;
        }
        if !accepted {
            // the paper's model knows where the target is at first, and frees it after a step: with the target elsewhere, any step is a gain
            let frees_all = |s: &Step| {
                request.model() == Model::Paper && lone_point(observed, arrangement, s) != s.first
            };
            let is_lone = |s: &Step| {
                s.n_minor == 1
                    && suspects
                        .iter()
                        .all(|p| *p == lone_point(observed, arrangement, s))
            };
            // one point beside gross errors is one more of them
            let lone = with_all.filter(|s| gross.is_empty() && is_lone(s) && !frees_all(s));
            screening
                .steps
                .extend(lone.iter().flat_map(|step| found(step, true)));
            break;
        }
    }
    screening.steps.sort_by_key(|s| s.row);
    Ok(outliers)
}

/// All points fitted but the gross errors.
struct WithoutGross {
    /// The gross errors: rows that stand alone and are off by more than [`GROSS_PER_REACH`].
    gross: Vec<usize>,
    fit: AllFit,
    /// All outliers, the gross errors among them.
    outliers: Option<Outliers>,
}

/// Rows that are off by metres pull the fit so far that the problem is linear about the wrong place, and hide there what moved. They are left out before
/// anything is searched for, again from each fit without those found.
fn without_gross(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
) -> Result<WithoutGross, Error> {
    let mut gross: Vec<usize> = Vec::new();
    let mut n_searches = 0;
    loop {
        let fit = fit_all(request, observed, arrangement, &gross)?;
        let outliers = fit.linear.outliers(fit.least_scale_mm);
        let limit_mm = GROSS_PER_REACH * fit.reach_mm;
        let rest = arrangement.order.iter().filter(|p| !gross.contains(p));
        let rest: Vec<usize> = rest.copied().collect();
        let lone = lone_suspects(observed, &rest, outliers.as_ref(), FEWEST_MOVED);
        let together = outlying_together(observed, &rest, outliers.as_ref());
        let is_alone = |point: &usize| {
            gross.contains(point) || (lone.contains(point) && !together.contains(point))
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
        if found == gross || n_searches == MAX_SEARCHES {
            return Ok(WithoutGross {
                gross,
                fit,
                outliers,
            });
        }
        gross = found;
    }
}

/// Points that are off by metres pull the fit so far that the problem is linear about the wrong place, and hide others there. Looks again from the
/// fit without them; `None` if there were none.
fn search_again(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    outliers: Option<&Outliers>,
) -> Result<Option<Outliers>, Error> {
    let Some(outliers) = outliers.filter(|outliers| !outliers.points.is_empty()) else {
        return Ok(None);
    };
    let fit = fit_all(request, observed, arrangement, &outliers.points)?;
    Ok(fit.linear.outliers(fit.least_scale_mm))
}

/// The points on the smaller side of a step.
fn minor_side(observed: &Observed, arrangement: &Arrangement, step: &Step) -> Vec<usize> {
    let moves = |p: &&usize| match step.moved {
        Moved::Target(target) => observed.targets[**p] == target,
        Moved::AllTargets | Moved::Base => true,
    };
    let at = arrangement
        .order
        .iter()
        .position(|p| *p == step.first)
        .unwrap_or(0);
    let (before, after) = arrangement.order.split_at(at);
    let side = |points: &[usize]| -> Vec<usize> { points.iter().filter(moves).copied().collect() };
    let (before, after) = (side(before), side(after));
    if before.len() < after.len() {
        before
    } else {
        after
    }
}

/// Suspects in a row at an end of the file that are all points of two configurations or more with several targets: what was knocked moves like that.
fn outlying_together(
    observed: &Observed,
    order: &[usize],
    outliers: Option<&Outliers>,
) -> Vec<usize> {
    let n_targets = observed.targets.iter().max().map_or(1, |target| target + 1);
    let is_suspect = |p: &usize| outliers.is_some_and(|found| found.points.contains(p));
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
fn lone_suspects(
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

fn find(observed: &Observed, fit: &AllFit, order: &[usize]) -> Option<Step> {
    let rows: Vec<usize> = order.iter().flat_map(|p| 3 * p..3 * p + 3).collect();
    let problem = Whitened::new(&fit.linear.of(order), &fit.features.select_rows(&rows));
    let clusters = observed.all_clusters();
    let least_scale_mm = fit.least_scale_mm;
    let campaign = Campaign {
        problem: &problem,
        columns: &fit.columns,
        order,
        targets: &observed.targets,
        clusters: &clusters,
        least_scale_mm,
    };
    campaign.step()
}

fn split(observed: &Observed, fit: &AllFit, arrangement: &Arrangement, step: &Step) -> Arrangement {
    let mut trial = arrangement.clone();
    match step.moved {
        Moved::Target(_) | Moved::AllTargets => {
            let firsts = step.of_targets.iter().map(|shift| shift.first);
            firsts.for_each(|first| trial.split_target(observed, first));
        }
        Moved::Base => trial.split_base(
            step.first,
            &motion(&step.shift_mm, &step.turn_rad, &fit.columns.centre),
        ),
    }
    trial
}

/// What is told of a step: of each target, or of the base.
fn found(step: &Step, is_one_point: bool) -> Vec<FoundStep> {
    if step.moved == Moved::Base {
        return vec![FoundStep {
            moved: WhatMoved::Base,
            row: step.first,
            vector_mm: step.shift_mm,
            turn_rad: step.turn_rad,
            is_one_point,
        }];
    }
    let of_target = |shift: &TargetShift| FoundStep {
        moved: WhatMoved::Target(shift.target),
        row: shift.first,
        vector_mm: shift.shift_mm,
        turn_rad: Vector3::zeros(),
        is_one_point,
    };
    step.of_targets.iter().map(of_target).collect()
}

/// The point that a step at an end cuts off.
fn lone_point(observed: &Observed, arrangement: &Arrangement, step: &Step) -> usize {
    let of_target = |p: &&usize| observed.targets[**p] == observed.targets[step.first];
    let last = arrangement
        .order
        .iter()
        .rfind(of_target)
        .copied()
        .unwrap_or(step.first);
    if last == step.first {
        last
    } else {
        arrangement
            .order
            .iter()
            .find(of_target)
            .copied()
            .unwrap_or(last)
    }
}

/// What the outliers are to the fit.
fn leave_out(
    request: &CalibrationRequest,
    observed: &mut Observed,
    screening: &mut Screening,
    outliers: &Outliers,
) {
    let size = |(point, size): (&usize, &f64)| Outlier {
        row: *point,
        size_mm: size / observed.all[*point].weight.sqrt(),
    };
    screening.outliers = outliers
        .points
        .iter()
        .zip(&outliers.sizes_mm)
        .map(size)
        .collect();
    screening.scale_mm = outliers.scale_mm;
    let is_more_than =
        |share: f64| outliers.points.len() > (share * observed.all.len() as f64).ceil() as usize;
    screening.is_for_review = is_more_than(REVIEW_SHARE);
    let to_identify = |point: &&usize| observed.subsets[**point] == Subset::Identify;
    let n_to_identify = observed.of(Subset::Identify).len() as f64;
    let n_left_out = outliers.points.iter().filter(to_identify).count() as f64;
    screening.are_few =
        !is_more_than(LEFT_OUT_SHARE) && n_left_out <= (LEFT_OUT_OF_SUBSET * n_to_identify).ceil();
    screening.is_down_weighted = request.options.loss.is_none() && screening.are_few;
    if screening.is_down_weighted {
        let down: Vec<usize> = outliers
            .points
            .iter()
            .filter(to_identify)
            .copied()
            .collect();
        down.iter()
            .for_each(|point| observed.all[*point].weight = 0.0);
    }
}

/// The loss that the fit takes: the one asked for, else squares; with too many outliers to leave out, Huber's, which keeps them all and
/// lets none pull hard.
pub fn loss(request: &CalibrationRequest, screening: &Screening) -> Loss {
    let ours = if screening.is_for_review && !screening.is_down_weighted {
        Loss::Huber
    } else {
        Loss::Squares
    };
    request.options.loss.unwrap_or(ours)
}

/// Least squares on all points but a few, with the motions between set-ups; and the linear problem of all points there.
fn fit_all(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    without: &[usize],
) -> Result<AllFit, Error> {
    let weights: Vec<f64> = observed.all.iter().map(|o| o.weight).collect();
    without.iter().for_each(|p| observed.all[*p].weight = 0.0);
    let model = fit_motions(request, observed, arrangement, None)?;
    let all = observed.all.iter_mut().zip(weights);
    all.for_each(|(o, weight)| o.weight = weight);
    arrangement.apply(observed);
    let parameters = parameters_of(request, &arrangement.fitted_targets(observed))?;
    let columns = Columns::new(&model, &observed.all);
    let everything: Vec<usize> = (0..observed.all.len()).collect();
    let derivatives = derivatives(
        &model,
        &parameters,
        &observed.all,
        &columns,
        arrangement,
        &everything,
    );
    let reach_mm = reach_mm(&model.links, observed.all.iter());
    let rounding_mm = ROUNDING_PER_REACH * reach_mm;
    let residuals = weighted_residuals(&model, &observed.all);
    let linear = Linearised::new(&residuals, derivatives, rounding_mm);
    let gravity = gravity_directions(request.robot.mounting.as_ref().map(|m| &m.gravity_in_base));
    let poses = observed
        .all
        .iter()
        .map(|o| (o.q_rad.as_slice(), o.target, o.weight));
    let features = features(&model, poses, &gravity);
    Ok(AllFit {
        linear,
        columns,
        features,
        least_scale_mm: stated_scale_mm(&request.set).max(rounding_mm),
        reach_mm,
    })
}
