//! Screening before the identification: which points are outliers, and did anything move during the measurement?
//!
//! Both questions concern the measurement, so all points of the upload are used, including those to verify. No robot parameter is taken from these
//! fits.

use crate::calibration::Error;
use crate::calibration::preparation::all_fit::{AllFit, SessionErrors, fit_all, session_errors};
use crate::calibration::preparation::arrangement::{Arrangement, FittedTargets, motion};
use crate::calibration::preparation::gross_errors::{
    MAX_SEARCHES, WithoutGross, isolated_outliers, without_gross,
};
use crate::calibration::preparation::motions::{fit_motions, place_setups};
use crate::calibration::preparation::observe::Observed;
use crate::calibration::preparation::turned_poses::{TurnedPose, turned_poses, turned_target};
use crate::calibration::request::{CalibrationRequest, Loss, Model, Preset};
use crate::identification::screening::outliers::Outliers;
use crate::identification::screening::steps::{Campaign, Jump, Moved, Step};
use crate::identification::screening::whitening::Whitened;
use crate::kinematics::Link;
use crate::measurement::Subset;
use crate::solvers::watch::Watch;
use std::collections::{BTreeMap, BTreeSet};

/// If more than this share of all points are outliers, a person has to review them.
const REVIEW_SHARE: f64 = 0.05;
/// Maximum share of all points that may be left out of the fit.
const LEFT_OUT_SHARE: f64 = 0.1;
/// Maximum share of the identify points that may be left out. It is larger, because most outliers may be among them by chance.
const LEFT_OUT_OF_SUBSET: f64 = 0.2;
/// A step is rejected if at least this share of the points on its smaller side remain outliers. A false step explains only one of two or
/// three outliers.
const SCATTERED: f64 = 0.25;
/// Maximum number of steps. With more, the measurement is not worth fitting.
const MAX_STEPS: usize = 4;

/// An outlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// 0-based data row.
    pub row: usize,
    /// Distance from the position that the other points predict, mm; 0 if only the rotation is off.
    pub size_mm: f64,
    /// For a pose whose rotation is off: angle to the rotation that the other points predict, rad.
    pub angle_rad: Option<f64>,
}

/// Result of the screening.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Screening {
    /// Outliers, by row.
    pub outliers: Vec<Outlier>,
    /// Standard deviation of one coordinate of the other points, mm.
    pub scale_mm: f64,
    /// True if the outliers among the identify points get weight 0: they are few enough, and the request names no loss.
    pub is_down_weighted: bool,
    /// True if there are so many outliers that a person has to review them.
    pub is_for_review: bool,
    /// True if the outliers are few enough to be left out of comparisons.
    pub are_few: bool,
    /// Steps, by row.
    pub steps: Vec<Step>,
    /// Backlash, shared errors and drift.
    pub over_session: SessionErrors,
    /// Rows of segments without identify points. They are scored with the segment before.
    pub unfitted_rows: Vec<usize>,
    /// The targets of the fit.
    pub targets: FittedTargets,
}

impl Screening {
    /// Rows that are left out of comparisons.
    pub fn rows_left_out(&self) -> impl Iterator<Item = usize> {
        let left_out = self.outliers.iter().filter(|_| self.are_few);
        left_out.map(|outlier| outlier.row)
    }
}

/// Screens the points and arranges them for the fit. Outliers lose their weight. Points before and after a step are separated.
pub fn screen(
    request: &CalibrationRequest,
    observed: &mut Observed,
    watch: &Watch<'_>,
) -> Result<(Screening, Arrangement), Error> {
    let mut arrangement = Arrangement::of(request);
    let mut screening = Screening::default();
    place_setups(request, observed, &mut arrangement, watch)?;
    if request.preset == Preset::Default {
        let Searched {
            mut outliers,
            gross: mut fitted_without,
            links,
        } = search(request, observed, &mut arrangement, &mut screening, watch)?;
        for _ in 0..MAX_SEARCHES {
            // The fit without these outliers is already known.
            if outliers
                .as_ref()
                .is_some_and(|w| w.points == fitted_without)
            {
                break;
            }
            let again = search_again(
                request,
                observed,
                &mut arrangement,
                outliers.as_ref(),
                watch,
            )?;
            let same =
                |again: &Outliers| outliers.as_ref().is_some_and(|w| w.points == again.points);
            if again.as_ref().is_none_or(same) {
                break;
            }
            fitted_without = outliers.map_or(vec![], |w| w.points);
            outliers = again;
        }
        while screening.steps.len() < MAX_STEPS
            && let Some(twist) = turned_target(
                [&links, &request.robot.links],
                observed,
                &arrangement,
                watch,
            )
        {
            arrangement.split_target(observed, twist.first);
            screening.steps.push(twist);
        }
        screening.steps.sort_by_key(|s| s.first);
        screening.unfitted_rows = arrangement.join_unfitted(observed);
        // A pose counts as turned only if it is turned for both robots: positions may not determine the flange of the fitted links, and the
        // nominal robot may have unmastered joints.
        let for_nominal = turned_poses(&request.robot.links, observed, &arrangement);
        let turned: Vec<TurnedPose> = turned_poses(&links, observed, &arrangement)
            .into_iter()
            .filter(|pose| for_nominal.iter().any(|other| other.point == pose.point))
            .collect();
        if outliers.is_some() || !turned.is_empty() {
            leave_out(
                request,
                observed,
                &mut screening,
                outliers.as_ref(),
                &turned,
            );
        }
    }
    fit_motions(
        request,
        observed,
        &mut arrangement,
        Some(Subset::Identify),
        watch,
    )?;
    if watch.was_stopped() {
        return Err(Error::Cancelled);
    }
    arrangement.apply(observed);
    screening.targets = arrangement.fitted_targets(observed);
    Ok((screening, arrangement))
}

/// Result of a search for steps and outliers.
struct Searched {
    outliers: Option<Outliers>,
    /// The points that the last fit left out.
    gross: Vec<usize>,
    /// The links of the last fit.
    links: Vec<Link>,
}

/// Finds steps one after another, and the remaining outliers.
fn search(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    screening: &mut Screening,
    watch: &Watch<'_>,
) -> Result<Searched, Error> {
    let WithoutGross {
        gross,
        mut fit,
        mut outliers,
    } = without_gross(request, observed, arrangement, watch)?;
    let others = |points: &[usize], left_out: &[usize]| -> Vec<usize> {
        let left_out: BTreeSet<usize> = left_out.iter().copied().collect();
        let is_other = |p: &&usize| !left_out.contains(p);
        points.iter().filter(is_other).copied().collect()
    };
    while screening.steps.len() < MAX_STEPS && !watch.was_stopped() {
        let suspects = outliers
            .as_ref()
            .map_or(vec![], |w| others(&w.points, &gross));
        let order = others(&arrangement.order, &gross);
        let belonging = others(&order, &suspects);
        let with_all = find(observed, &fit, &order, watch);
        let lone = isolated_outliers(observed, &order, outliers.as_ref(), 2);
        let without_lone = (!lone.is_empty() && lone.len() < suspects.len())
            .then(|| find(observed, &fit, &others(&order, &lone), watch));
        let without = if suspects.is_empty() {
            None
        } else {
            find(observed, &fit, &belonging, watch)
        };
        let mut accepted = false;
        // If outliers are in the fit, a step must explain at least one of them. If there are segments of outliers, it must explain at least
        // half of their points.
        let in_segments = suspects.len() - lone.len();
        let tried = [
            (&with_all, suspects.len().min(1)),
            (&without_lone.flatten(), in_segments.div_ceil(2)),
            (&without, 0),
        ];
        for (jump, n_to_explain) in tried {
            let Some(jump) = jump.as_ref().filter(|jump| jump.n_minor > 1) else {
                continue;
            };
            let mut trial = split(observed, &fit, arrangement, jump);
            let refit = fit_all(request, observed, &mut trial, &gross, watch)?;
            let left = refit.outliers(watch);
            let n_left = left.as_ref().map(|w| others(&w.points, &gross).len());
            if n_left.is_some_and(|n| n_to_explain > 0 && n + n_to_explain > suspects.len()) {
                continue;
            }
            // A real step explains the points on its smaller side. If many of them remain outliers, they do not form a segment.
            let minor = others(&minor_side(observed, arrangement, jump), &gross);
            let still_outlying = left.as_ref().map_or(0, |w| {
                // `points` is sorted in ascending order.
                let is_outlier = |p: &&usize| w.points.binary_search(p).is_ok();
                minor.iter().filter(is_outlier).count()
            });
            if still_outlying as f64 >= SCATTERED * minor.len() as f64 {
                continue;
            }
            screening.steps.extend(&jump.steps);
            (*arrangement, fit, outliers, accepted) = (trial, refit, left, true);
            break;
        }
        if !accepted {
            // The paper's model holds the target at its nominal position and frees it after a step. If the real target is elsewhere, any
            // step that frees it improves the fit.
            let frees_all = |jump: &Jump| {
                request.model() == Model::Paper
                    && lone_point(observed, arrangement, jump) != jump.first
            };
            let is_lone = |jump: &Jump| {
                let lone = lone_point(observed, arrangement, jump);
                jump.n_minor == 1 && suspects.iter().all(|p| *p == lone)
            };
            // If there are gross errors, a single point is probably another one and not a step.
            let lone = with_all.filter(|s| gross.is_empty() && is_lone(s) && !frees_all(s));
            screening
                .steps
                .extend(lone.iter().flat_map(|jump| &jump.steps));
            break;
        }
    }
    let outlying = outliers.as_ref().map_or(vec![], |w| w.points.clone());
    let belonging = others(&others(&arrangement.order, &gross), &outlying);
    screening.over_session = session_errors(observed, &fit, &belonging, watch);
    Ok(Searched {
        outliers,
        gross,
        links: fit.links,
    })
}

/// Searches for outliers again, starting from the fit without those already found; `None` if none had been found. Points that are off by
/// metres change the fit so much that the linearisation is invalid and other outliers stay hidden.
fn search_again(
    request: &CalibrationRequest,
    observed: &mut Observed,
    arrangement: &mut Arrangement,
    outliers: Option<&Outliers>,
    watch: &Watch<'_>,
) -> Result<Option<Outliers>, Error> {
    let Some(outliers) = outliers.filter(|outliers| !outliers.points.is_empty()) else {
        return Ok(None);
    };
    let fit = fit_all(request, observed, arrangement, &outliers.points, watch)?;
    Ok(fit.outliers(watch))
}

/// The points on the smaller side of a jump.
fn minor_side(observed: &Observed, arrangement: &Arrangement, jump: &Jump) -> Vec<usize> {
    let moves = |p: &&usize| {
        let is_of = |target| observed.targets[**p] == target;
        jump.target.is_none_or(is_of)
    };
    let at = arrangement
        .order
        .iter()
        .position(|p| *p == jump.first)
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

fn find(observed: &Observed, fit: &AllFit, order: &[usize], watch: &Watch<'_>) -> Option<Jump> {
    if !watch.goes_on() {
        return None;
    }
    let rows: Vec<usize> = order.iter().flat_map(|p| 3 * p..3 * p + 3).collect();
    let (linear, features) = (fit.linear.of(order), fit.features.select_rows(&rows));
    let problem = Whitened::new(&linear, &features, watch);
    let clusters = observed.all_clusters();
    let least_scale_mm = fit.least_scale_mm;
    let campaign = Campaign {
        linear: &linear,
        features: &features,
        problem: &problem,
        columns: &fit.columns,
        order,
        targets: &observed.targets,
        clusters: &clusters,
        least_scale_mm,
        watch,
    };
    campaign.jump()
}

fn split(observed: &Observed, fit: &AllFit, arrangement: &Arrangement, jump: &Jump) -> Arrangement {
    let mut trial = arrangement.clone();
    for step in &jump.steps {
        match step.moved {
            Moved::Target(_) => trial.split_target(observed, step.first),
            Moved::Base => trial.split_base(
                step.first,
                &motion(&step.shift_mm, &step.turn_rad, &fit.columns.centre),
            ),
        }
    }
    trial
}

/// The single point that a jump at an end separates.
fn lone_point(observed: &Observed, arrangement: &Arrangement, jump: &Jump) -> usize {
    let of_target = |p: &&usize| observed.targets[**p] == observed.targets[jump.first];
    let mut of_target = arrangement.order.iter().filter(of_target).copied();
    let first = of_target.next().unwrap_or(jump.first);
    let last = of_target.last().unwrap_or(first);
    if last == jump.first { last } else { first }
}

/// Records the outliers. Sets the weight of those to identify to 0 if they are few enough.
fn leave_out(
    request: &CalibrationRequest,
    observed: &mut Observed,
    screening: &mut Screening,
    outliers: Option<&Outliers>,
    turned: &[TurnedPose],
) {
    let displaced = outliers
        .into_iter()
        .flat_map(|found| found.points.iter().zip(&found.sizes_mm))
        .map(|(point, size)| (*point, size / observed.all[*point].weight.sqrt()));
    let mut by_row: BTreeMap<usize, Outlier> = displaced
        .map(|(row, size_mm)| {
            let angle_rad = None;
            (
                row,
                Outlier {
                    row,
                    size_mm,
                    angle_rad,
                },
            )
        })
        .collect();
    for pose in turned {
        let outlier = by_row.entry(pose.point).or_insert(Outlier {
            row: pose.point,
            size_mm: 0.0,
            angle_rad: None,
        });
        outlier.angle_rad = Some(pose.angle_rad);
    }
    screening.outliers = by_row.into_values().collect();
    screening.scale_mm = outliers.map_or(0.0, |found| found.scale_mm);
    let points: Vec<usize> = screening.outliers.iter().map(|found| found.row).collect();
    let is_more_than =
        |share: f64| points.len() > (share * observed.all.len() as f64).ceil() as usize;
    screening.is_for_review = is_more_than(REVIEW_SHARE);
    let to_identify = |point: &&usize| observed.subsets[**point] == Subset::Identify;
    let n_to_identify = observed.of(Subset::Identify).len() as f64;
    let n_left_out = points.iter().filter(to_identify).count() as f64;
    screening.are_few =
        !is_more_than(LEFT_OUT_SHARE) && n_left_out <= (LEFT_OUT_OF_SUBSET * n_to_identify).ceil();
    screening.is_down_weighted = request.options.loss.is_none() && screening.are_few;
    if screening.is_down_weighted {
        let down: Vec<usize> = points.iter().filter(to_identify).copied().collect();
        down.iter()
            .for_each(|point| observed.all[*point].weight = 0.0);
    }
}

/// The loss of the fit: that of the request, else squares. With too many outliers to leave out, it is Huber's loss, which keeps all points and limits
/// their influence; it needs the scatter of the points.
pub fn loss(request: &CalibrationRequest, screening: &Screening) -> Loss {
    let limits_outliers = screening.is_for_review && !screening.is_down_weighted;
    let ours = if limits_outliers && screening.scale_mm > 0.0 {
        Loss::Huber
    } else {
        Loss::Squares
    };
    request.options.loss.unwrap_or(ours)
}
