//! How well the nominal robot fits measured points, with base, targets and joint zeros fitted. Gross rows have no influence: the rows that fit worst
//! are left out of the fit and of its rms.

use super::explanation::n_targets;
use crate::identification::KinematicModel;
use crate::identification::least_squares::multistart::{best_fitting, median_mm};
use crate::identification::least_squares::start::{
    align_in_closed_form, fit_base_and_targets, fit_targets,
};
use crate::identification::model::objective::{Observation, cost};
use crate::identification::model::parameters::{Parameter, Quantity};
use crate::identification::search::fit::fit_least_squares;
use crate::kinematics::rotation::within_half_a_turn;
use crate::kinematics::{self, Link, t_base_flange};
use crate::measurement::Frame;
use crate::solvers::median::median;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::f64::consts::PI;
use std::ops::Range;

/// Minimum redundancy for any conclusion. With it, a wrong robot whose points are off by a tenth of its reach fits to a hundredth of the
/// reach by chance in one of 10⁶ files.
const SPARE_EQUATIONS: usize = 6;
/// Unknowns of a free base in closed form: nine of its rotation, three of its translation.
const CLOSED_FORM_BASE: usize = 12;
/// One of this many rows may be gross and is left out. Files with a tenth of gross rows occur.
const LEFT_OUT: usize = 5;
/// Maximum number of concentration steps [Rousseeuw & Van Driessen 2006]; they converge in a few.
const CONCENTRATIONS: usize = 6;
/// Number of small subsets that a placement starts from. With a tenth of gross rows, eight rows contain none with probability 0.43.
const SUBSETS: usize = 8;
/// Rows of such a subset in addition to those that the closed form needs: eight rows with one target.
const SPARE_ROWS: usize = 3;
/// Number of starts with other joint zeros; number of their results that are refined without gross rows; largest zero error of a start, rad
/// (45°).
const ZERO_STARTS: usize = 10;
const ZERO_ENDS: usize = 3;
const WIDEST_RAD: f64 = PI / 4.0;
/// Two fits whose rms differ by less than this factor are equally good.
const EQUALLY_GOOD: f64 = 1.5;
/// If the points' spread is below this share of the arm's reach, their unit may be larger than assumed.
const SMALL_SPREAD: f64 = 0.02;
/// Lower limit of the spread, as a share of the reach. If all rows have the same position, the spread is zero.
const LEAST_SPREAD: f64 = 1e-4;
/// If the spread of the flanges is below this share of the arm's reach, all poses count as one pose whose joints were read to 0.001°.
const SAME_POSE: f64 = 1e-5;

/// A robot fitted to points.
#[derive(Clone, Debug)]
pub(super) struct Fitted {
    /// rms of the distances, mm, computed with the redundancy of the fit.
    pub rms_mm: f64,
    /// The fitted model.
    pub model: KinematicModel,
}

/// The robot's length along its links, but at least the spread of the points, for a robot whose links have no length.
pub(super) fn reach_mm(links: &[Link], observations: &[Observation]) -> f64 {
    let of_links: f64 = links.iter().map(|l| l.a_mm.abs() + l.d_mm.abs()).sum();
    of_links.max(spread_mm(observations))
}

/// rms distance of the points from their centre, mm.
pub(super) fn spread_mm(observations: &[Observation]) -> f64 {
    rms_from_centre(observations.iter().map(|o| o.position_mm))
}

/// The same for the flange positions that the joint values give.
fn flange_spread_mm(links: &[Link], observations: &[Observation]) -> f64 {
    let flange = |o: &Observation| t_base_flange(links, &o.q_rad).translation.vector;
    rms_from_centre(observations.iter().map(flange))
}

fn rms_from_centre(points: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let points: Vec<Vector3<f64>> = points.collect();
    let n = points.len() as f64;
    let centre = points.iter().sum::<Vector3<f64>>() / n;
    let squares: f64 = points.iter().map(|p| (p - centre).norm_squared()).sum();
    (squares / n).sqrt()
}

/// The free parameters of a placement: targets, and the base if it is unknown.
fn placing(frame: Frame, n_targets: usize) -> Vec<Parameter> {
    let n_base = if frame == Frame::Instrument { 3 } else { 0 };
    let base = (0..n_base)
        .map(Parameter::BaseTranslation)
        .chain((0..n_base).map(Parameter::BaseRotation));
    let targets =
        (0..n_targets).flat_map(|target| (0..3).map(move |axis| Parameter::Target(target, axis)));
    base.chain(targets).collect()
}

/// Number of unknowns of a free base and the targets in closed form.
fn closed_form_unknowns(n_targets: usize) -> usize {
    CLOSED_FORM_BASE + 3 * n_targets
}

/// Redundancy; `None` if it is too small for a conclusion.
fn spare_equations(n_points: usize, n_free: usize) -> Option<usize> {
    let spare = (3 * n_points).checked_sub(n_free)?;
    (spare >= SPARE_EQUATIONS).then_some(spare)
}

/// The fit with its rms, computed with the redundancy. If the points hardly differ in position, e.g. because metres were taken for
/// millimetres, they would always seem to fit; the rms is then scaled up. `None` if the redundancy is too small for a conclusion.
fn fitted(model: KinematicModel, observations: &[Observation], n_free: usize) -> Option<Fitted> {
    let spare = spare_equations(observations.len(), n_free)?;
    let reach_mm = kinematics::reach_mm(&model.links);
    let unlike = match flange_spread_mm(&model.links, observations) > SAME_POSE * reach_mm {
        true => (SMALL_SPREAD * reach_mm / spread_mm(observations).max(LEAST_SPREAD * reach_mm))
            .max(1.0),
        // If the poses do not differ, the points are close together for any robot.
        false => 1.0,
    };
    let rms_mm = (3.0 * cost(&model, observations) / spare as f64).sqrt() * unlike;
    rms_mm.is_finite().then_some(Fitted { rms_mm, model })
}

/// Places the robot from all rows in closed form: fast, and accurate to some millimetres if the file is right.
pub(super) fn quickly_placed(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
) -> Option<Fitted> {
    let n_targets = n_targets(observations);
    let unknowns = closed_form_unknowns(n_targets);
    if frame == Frame::Instrument && spare_equations(observations.len(), unknowns).is_none() {
        return None;
    }
    let model = closed_form(links, observations, n_targets, frame)?;
    let n_free = placing(frame, n_targets).len();
    fitted(model, observations, n_free)
}

fn closed_form(
    links: &[Link],
    observations: &[Observation],
    n_targets: usize,
    frame: Frame,
) -> Option<KinematicModel> {
    match frame {
        Frame::Base if observations.is_empty() => None,
        Frame::Base => Some(fit_targets(links, observations, n_targets)),
        Frame::Instrument if 3 * observations.len() < closed_form_unknowns(n_targets) => None,
        Frame::Instrument => align_in_closed_form(links, observations, n_targets, false),
    }
}

/// The robot in its base frame, with each target at the median of its points in the flange's frame.
fn with_median_targets(links: &[Link], observations: &[Observation]) -> KinematicModel {
    let in_flange = |o: &Observation| {
        let flange = t_base_flange(links, &o.q_rad);
        flange
            .rotation
            .inverse_transform_vector(&(o.position_mm - flange.translation.vector))
    };
    let mut model = KinematicModel::nominal(links, n_targets(observations));
    for (target, position_mm) in model.targets_mm.iter_mut().enumerate() {
        let of_target = observations.iter().filter(|o| o.target == target);
        *position_mm = middle(&of_target.map(in_flange).collect::<Vec<_>>());
    }
    model
}

/// Places the robot with the gross rows left out.
pub(super) fn placed(links: &[Link], observations: &[Observation], frame: Frame) -> Option<Fitted> {
    let parameters = placing(frame, n_targets(observations));
    let concentrate = |start| concentrated(start, &parameters, observations);
    best(
        starts(links, observations, frame)
            .into_iter()
            .filter_map(concentrate),
    )
}

/// As [`placed`], but also starts from bases in all directions. Used before a set is said not to fit.
pub(super) fn placed_thoroughly(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
) -> Option<Fitted> {
    let from_everywhere = (frame == Frame::Instrument && !observations.is_empty())
        .then(|| fit_base_and_targets(links, observations, n_targets(observations)))
        .and_then(|start| {
            let parameters = placing(frame, n_targets(observations));
            concentrated(start, &parameters, observations)
        });
    best(
        placed(links, observations, frame)
            .into_iter()
            .chain(from_everywhere),
    )
}

/// Starts of a placement. Some come from small subsets, which may be free of gross rows.
fn starts(links: &[Link], observations: &[Observation], frame: Frame) -> Vec<KinematicModel> {
    if observations.is_empty() {
        return vec![];
    }
    if frame == Frame::Base {
        return vec![with_median_targets(links, observations)];
    }
    let (n, n_targets) = (observations.len(), n_targets(observations));
    let n_rows = closed_form_unknowns(n_targets) / 3 + SPARE_ROWS;
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut subset = || -> Vec<Observation> {
        (0..n_rows)
            .map(|_| {
                observations[((random.random::<f64>() * n as f64) as usize).min(n - 1)].clone()
            })
            .collect()
    };
    let of_subsets = (0..SUBSETS).filter_map(|_| closed_form(links, &subset(), n_targets, frame));
    let nearest =
        of_subsets.min_by(|a, b| median_mm(a, observations).total_cmp(&median_mm(b, observations)));
    closed_form(links, observations, n_targets, frame)
        .into_iter()
        .chain(nearest)
        .collect()
}

/// Median along each axis.
fn middle(vectors: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| median(vectors.iter().map(|v| v[axis])).unwrap_or(0.0))
}

fn best(fits: impl Iterator<Item = Fitted>) -> Option<Fitted> {
    fits.min_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm))
}

/// Repeatedly fits the rows that fit best.
fn concentrated(
    start: KinematicModel,
    parameters: &[Parameter],
    observations: &[Observation],
) -> Option<Fitted> {
    let mut model = start;
    let mut found: Option<Fitted> = None;
    for _ in 0..CONCENTRATIONS {
        let mut kept = best_fitting(&model, observations, LEFT_OUT);
        if spare_equations(kept.len(), parameters.len()).is_none() {
            kept = observations.to_vec(); // too few rows to leave any out
        }
        model = fit_least_squares(&model, parameters, &kept).model;
        let next = fitted(model.clone(), &kept, parameters.len())?;
        // The fit has converged if the rms decreases by less than one per cent.
        let is_settled = found
            .as_ref()
            .is_some_and(|last| next.rms_mm > 0.99 * last.rms_mm);
        found = best(found.into_iter().chain([next]));
        if is_settled {
            break;
        }
    }
    found
}

/// A fit with every joint's zero free.
#[derive(Clone, Debug)]
pub(super) struct Zeroed {
    /// rms of the fit, mm.
    pub rms_mm: f64,
    /// Zero error of each joint, rad, within half a turn.
    pub offsets_rad: Vec<f64>,
}

impl Zeroed {
    /// The largest zero error, rad.
    pub fn largest_rad(&self) -> f64 {
        self.offsets_rad
            .iter()
            .fold(0.0, |largest, o| o.abs().max(largest))
    }
}

/// Fast fit with every joint's zero free, starting from the given links.
pub(super) fn quickly_with_free_zeros(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
) -> Option<Zeroed> {
    with_zeros_from(links, observations, frame, 0, 0.0)
}

/// Thorough fit with every joint's zero free, from several starts. An rms of `enough_mm` ends the search for a better start. Two zeros are
/// not observable. That of the last joint is equivalent to a rotation of the target; that of the first joint is equivalent to a rotation of
/// the base if the base is free.
pub(super) fn with_free_zeros(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
    enough_mm: f64,
) -> Option<Zeroed> {
    with_zeros_from(links, observations, frame, ZERO_STARTS, enough_mm)
}

/// Joints whose zero is observable. The zero of the last joint is equivalent to a rotation of the target, that of the first joint to a
/// rotation of the base if the base is free.
fn seen_joints(links: &[Link], frame: Frame) -> Range<usize> {
    let first = usize::from(frame == Frame::Instrument);
    first..links.len().saturating_sub(1).max(first)
}

/// The rms and the zero errors of a fit.
fn zeroed(fit: &Fitted, links: &[Link]) -> Zeroed {
    let offset = |(found, link): (&Link, &Link)| {
        within_half_a_turn(found.theta_offset_rad - link.theta_offset_rad)
    };
    Zeroed {
        rms_mm: fit.rms_mm,
        offsets_rad: fit.model.links.iter().zip(links).map(offset).collect(),
    }
}

fn with_zeros_from(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
    n_starts: usize,
    enough_mm: f64,
) -> Option<Zeroed> {
    let n_targets = n_targets(observations);
    let free = seen_joints(links, frame);
    let mut parameters: Vec<Parameter> = free
        .clone()
        .map(|link| Parameter::Link(link, Quantity::ThetaOffset))
        .collect();
    parameters.extend(placing(frame, n_targets));
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut ends: Vec<(f64, KinematicModel)> = Vec::new();
    for start in 0..=n_starts {
        let widest_rad = WIDEST_RAD * start as f64 / ZERO_STARTS as f64;
        let mut turned = links.to_vec();
        for link in free.clone() {
            turned[link].theta_offset_rad += widest_rad * (2.0 * random.random::<f64>() - 1.0);
        }
        let placed = if start == 0 {
            starts(&turned, observations, frame)
        } else {
            closed_form(&turned, observations, n_targets, frame)
                .into_iter()
                .collect()
        };
        for start in placed {
            let end = fit_least_squares(&start, &parameters, observations).model;
            ends.push((median_mm(&end, observations), end));
        }
        if ends.iter().any(|(median_mm, _)| *median_mm <= enough_mm) {
            break;
        }
    }
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    ends.truncate(ZERO_ENDS);
    ends.into_iter()
        .map(|(_, end)| {
            let fit = concentrated(end, &parameters, observations)?;
            Some(zeroed(&fit, links))
        })
        .fold(None, better)
}

/// The better fit by rms. If both are equally good, the one with the smaller zero errors.
fn better(a: Option<Zeroed>, b: Option<Zeroed>) -> Option<Zeroed> {
    let (Some(a), Some(b)) = (&a, &b) else {
        return a.or(b);
    };
    let is_b = if a.rms_mm.max(b.rms_mm) <= EQUALLY_GOOD * a.rms_mm.min(b.rms_mm) {
        b.largest_rad() < a.largest_rad()
    } else {
        b.rms_mm < a.rms_mm
    };
    Some(if is_b { b.clone() } else { a.clone() })
}
