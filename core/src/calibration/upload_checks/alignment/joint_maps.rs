//! Makers' joint conventions: reversed joints, coupling of joint 3 to joint 2 (FANUC, arms with linkages), and zeros shifted by quarter turns. All
//! sign patterns are tried with each coupling and with up to three turned zeros, on some of the points. The simplest of the best-fitting conventions
//! is then fitted to all points.

use super::affine::{LinkFrame, affine_cost_mm2, beyond_affine, scatter_mm2};
use super::convention::{COUPLINGS, Convention};
use super::explanation::{UNMASTERED_RAD, n_targets};
use super::fitting::{
    Fitted, Zeroed, placed, quickly_placed, quickly_with_free_zeros, with_free_zeros,
};
use crate::identification::model::objective::Observation;
use crate::kinematics::Link;
use crate::kinematics::forward::t_previous_link;
use crate::kinematics::model::MAX_LINKS;
use crate::measurement::Frame;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Number of points that conventions are compared on.
const COMPARED_POINTS: usize = 18;
/// Minimum number of points of one target for trying all conventions. With fewer, one of them would fit by chance, and only makers' conventions are
/// tried. Twelve points give 36 equations for the fifteen unknowns of base and target.
const MIN_POINTS: usize = 12;
/// Number of disjoint selections of points, tried in turn, because a gross row spoils its selection.
const CHOICES: usize = 2;
/// Maximum number of joints with a turned zero. The first and the last joint are often unobservable, and the number of conventions grows with each
/// joint.
const MAX_TURNED: usize = 3;
/// Numbers of joints from which at most two, at most one, and no turned zero is tried. Arms with more joints have more sign patterns.
const TWO_TURNED_FROM: usize = 7;
const ONE_TURNED_FROM: usize = 8;
const NONE_TURNED_FROM: usize = 10;
/// Conventions whose rms is within this factor of the best one's are equally good. Symmetric arms have several equivalent conventions.
const EQUALLY_GOOD_RATIO: f64 = 2.0;
/// Maximum number of conventions that are fitted to all points.
const FITTED: usize = 40;
/// Maximum number of conventions that are refitted without gross rows.
const MAX_REFITTED: usize = 6;
/// Number of sign and coupling patterns that are fitted with free joint zeros, in addition to the makers' patterns. Those that fit best
/// without free zeros are taken.
const WITH_ZEROS: usize = 12;
/// Such a pattern is fitted thoroughly if its rms is within this factor of `fits_mm`.
const MAX_REFIT_RATIO: f64 = 5.0;
/// Minimum number of joints: makers' conventions concern joints 2 and 3.
const MIN_JOINTS: usize = 3;

/// One direction and coupling of a joint in a convention, at each of the compared points.
struct Turning {
    reversed: bool,
    /// Factor of joint 2's own value, before its sign.
    of_joint_2: f64,
    sine_cosine: Vec<(f64, f64)>,
}

/// A convention that was tried, in compact form: there may be hundreds of thousands.
#[derive(Clone, Copy)]
struct Tried {
    cost_mm2: f64,
    path: Path,
}

/// Index of the turning and number of quarter turns for each joint.
#[derive(Clone, Copy, Default)]
struct Path([u8; MAX_LINKS]);

/// The simplest of the best-fitting conventions, with its fit. It is never the robot's own convention. With few points only makers' signs and
/// couplings are tried; `None` if there are too few points even for them.
pub(super) fn search(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
    fits_mm: f64,
) -> Option<(Convention, Fitted)> {
    let of_target = of_one_target(observations);
    if of_target.len() < MIN_POINTS {
        return of_makers(links, observations, frame);
    }
    let mut found: Option<(Convention, Fitted)> = None;
    for choice in 0..CHOICES {
        let compared = chosen(&of_target, choice);
        let candidates = candidates(links, &compared, frame, fits_mm);
        let fits = fitted(links, candidates, observations, frame);
        let best_mm = fits
            .iter()
            .map(|(_, fit)| fit.rms_mm)
            .fold(f64::INFINITY, f64::min);
        // The candidates are sorted, simplest first.
        let simplest = fits
            .into_iter()
            .find(|(_, fit)| fit.rms_mm <= EQUALLY_GOOD_RATIO * best_mm);
        found = match (found, simplest) {
            (Some(a), Some(b)) if b.1.rms_mm >= a.1.rms_mm => Some(a),
            (a, b) => b.or(a),
        };
        if found.as_ref().is_some_and(|(_, fit)| fit.rms_mm <= fits_mm) {
            break;
        }
    }
    found
}

/// The simplest of the best-fitting makers' signs and couplings.
fn of_makers(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
) -> Option<(Convention, Fitted)> {
    let is_other = |convention: &Convention| convention.complexity() > 0;
    let mut fits: Vec<(Convention, Fitted)> = Convention::of_makers(links.len())
        .filter(|convention| links.len() >= MIN_JOINTS && is_other(convention))
        .filter_map(|convention| {
            let fitted = placed(links, &convention.observations(observations), frame)?;
            Some((convention, fitted))
        })
        .collect();
    let rms_mm = fits.iter().map(|(_, fit)| fit.rms_mm);
    let best_mm = rms_mm.fold(f64::INFINITY, f64::min);
    fits.retain(|(_, fit)| fit.rms_mm <= EQUALLY_GOOD_RATIO * best_mm);
    fits.into_iter()
        .min_by_key(|(convention, _)| convention.complexity())
}

/// As [`search`], with every joint's zero free, because joints that were never mastered hide a maker's convention. Zeros shifted by quarter
/// turns are left to [`search`]. Only a convention that fits is returned.
pub(super) fn search_with_zeros(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
    fits_mm: f64,
) -> Option<(Convention, Zeroed)> {
    let of_target = of_one_target(observations);
    if of_target.len() < MIN_POINTS || links.len() < MIN_JOINTS {
        return None;
    }
    let mut search = Search::new(links, &chosen(&of_target, 0), frame);
    search.most_turned = 0;
    search.run();
    search
        .tried
        .sort_by(|a, b| a.cost_mm2.total_cmp(&b.cost_mm2));
    search.tried.truncate(WITH_ZEROS);
    let nearest = search.tried.iter();
    let mut all: Vec<Convention> = nearest
        .map(|tried| search.convention(&tried.path))
        .collect();
    for maker in Convention::of_makers(links.len()) {
        // A coupling alone is among the nearest patterns if it fits well.
        if maker.reversed.contains(&true) && !all.contains(&maker) {
            all.push(maker);
        }
    }
    all.retain(|convention| convention.complexity() > 0);
    let with_zeros = with_all_zeros(links, observations, frame, fits_mm, all);
    simplest(with_zeros, fits_mm)
}

/// The conventions that fit nearly well enough with every joint's zero free.
fn with_all_zeros(
    links: &[Link],
    observations: &[Observation],
    frame: Frame,
    fits_mm: f64,
    conventions: Vec<Convention>,
) -> Vec<(Convention, Zeroed)> {
    let with_zeros = |convention: Convention| {
        let points = convention.observations(observations);
        Some((
            quickly_with_free_zeros(links, &points, frame)?.rms_mm,
            convention,
        ))
    };
    let mut quick: Vec<(f64, Convention)> =
        conventions.into_iter().filter_map(with_zeros).collect();
    quick.retain(|(rms_mm, _)| *rms_mm <= MAX_REFIT_RATIO * fits_mm);
    quick.sort_by(|a, b| a.0.total_cmp(&b.0));
    quick.truncate(MAX_REFITTED);
    let thoroughly = |(_, convention): (f64, Convention)| {
        let points = convention.observations(observations);
        let zeros = with_free_zeros(links, &points, frame, 0.5 * fits_mm)?;
        Some((convention, zeros))
    };
    quick.into_iter().filter_map(thoroughly).collect()
}

/// The simplest of the conventions that fit about as well as the best one, with zero errors that are possible for unmastered joints. Among
/// equally simple ones, the one with the smallest zero errors.
fn simplest(mut fits: Vec<(Convention, Zeroed)>, fits_mm: f64) -> Option<(Convention, Zeroed)> {
    fits.retain(|(_, zeros)| zeros.rms_mm <= fits_mm && zeros.largest_rad() <= UNMASTERED_RAD);
    let best_mm = fits
        .iter()
        .map(|(_, zeros)| zeros.rms_mm)
        .fold(f64::INFINITY, f64::min);
    fits.retain(|(_, zeros)| zeros.rms_mm <= EQUALLY_GOOD_RATIO * best_mm);
    fits.into_iter().min_by(|(a, x), (b, y)| {
        let simpler = a.complexity().cmp(&b.complexity());
        simpler.then(x.largest_rad().total_cmp(&y.largest_rad()))
    })
}

/// The conventions that fit all points about as well as the best one, in their order. All are fitted fast first; the remaining ones are
/// then refitted without gross rows.
fn fitted(
    links: &[Link],
    candidates: Vec<Convention>,
    observations: &[Observation],
    frame: Frame,
) -> Vec<(Convention, Fitted)> {
    let quickly = candidates.into_iter().filter_map(|convention| {
        let quick = quickly_placed(links, &convention.observations(observations), frame)?;
        Some((convention, quick.rms_mm))
    });
    let quick: Vec<(Convention, f64)> = quickly.collect();
    let best_mm = quick
        .iter()
        .map(|(_, rms)| *rms)
        .fold(f64::INFINITY, f64::min);
    quick
        .into_iter()
        .filter(|(_, rms_mm)| *rms_mm <= EQUALLY_GOOD_RATIO * best_mm)
        .take(MAX_REFITTED)
        .filter_map(|(convention, _)| {
            let fitted = placed(links, &convention.observations(observations), frame)?;
            Some((convention, fitted))
        })
        .collect()
}

/// Points of the target with the most points.
fn of_one_target(observations: &[Observation]) -> Vec<Observation> {
    let n_of = |target: usize| observations.iter().filter(|o| o.target == target).count();
    let most = (0..n_targets(observations)).max_by_key(|target| n_of(*target));
    let of_most = observations.iter().filter(|o| Some(o.target) == most);
    let of_most = of_most.cloned().map(|mut o| {
        o.target = 0;
        o
    });
    of_most.collect()
}

/// Evenly selected points.
fn chosen(observations: &[Observation], choice: usize) -> Vec<Observation> {
    let step = (observations.len() / COMPARED_POINTS).max(1);
    let first = choice % step;
    observations
        .iter()
        .skip(first)
        .step_by(step)
        .take(COMPARED_POINTS)
        .cloned()
        .collect()
}

/// Conventions worth fitting, simplest first.
fn candidates(
    links: &[Link],
    compared: &[Observation],
    frame: Frame,
    fits_mm: f64,
) -> Vec<Convention> {
    let mut search = Search::new(links, compared, frame);
    search.run();
    let n = compared.len() as f64;
    let lowest = search
        .tried
        .iter()
        .map(|tried| tried.cost_mm2)
        .fold(f64::INFINITY, f64::min);
    let bar_mm2 = (EQUALLY_GOOD_RATIO * EQUALLY_GOOD_RATIO * lowest).max(fits_mm * fits_mm * n);
    let mut near: Vec<(usize, f64, Convention)> = search
        .tried
        .iter()
        .filter(|tried| tried.cost_mm2 <= bar_mm2)
        .map(|tried| {
            let convention = search.convention(&tried.path);
            (convention.complexity(), tried.cost_mm2, convention)
        })
        .filter(|(complexity, ..)| *complexity > 0)
        .collect();
    near.sort_by(|a, b| a.1.total_cmp(&b.1));
    // First the best-fitting ones, whatever their complexity, then the simplest.
    let few = near.len().min(FITTED / 4);
    let mut rest = near.split_off(few);
    rest.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    rest.truncate(FITTED - few);
    near.extend(rest);
    near.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    near.into_iter()
        .map(|(.., convention)| convention)
        .collect()
}

/// Tree of conventions with one level per joint. The first joints are computed once for all conventions that differ only in later joints.
struct Search<'a> {
    links: &'a [Link],
    frame: Frame,
    most_turned: usize,
    turnings: Vec<Vec<Turning>>,
    /// Transform from each link's frame to the next one, before its joint turns.
    fixed: Vec<LinkFrame>,
    positions: Vec<Vector3<f64>>,
    /// Projector onto the part that no affine image of the measured positions explains.
    beyond_affine: DMatrix<f64>,
    tried: Vec<Tried>,
}

impl<'a> Search<'a> {
    fn new(links: &'a [Link], compared: &[Observation], frame: Frame) -> Self {
        let n = links.len();
        let positions: Vec<Vector3<f64>> = compared.iter().map(|o| o.position_mm).collect();
        let before_its_joint = |link: &Link| {
            let still = Link {
                theta_offset_rad: 0.0,
                d_mm: 0.0,
                ..*link
            };
            let t = t_previous_link(&still, 0.0);
            (*t.rotation.matrix(), t.translation.vector)
        };
        Self {
            links,
            frame,
            most_turned: match n {
                NONE_TURNED_FROM.. => 0,
                ONE_TURNED_FROM.. => 1,
                TWO_TURNED_FROM.. => 2,
                _ => MAX_TURNED,
            },
            turnings: (0..n)
                .map(|joint| turnings(links, compared, joint))
                .collect(),
            fixed: links.iter().map(before_its_joint).collect(),
            beyond_affine: beyond_affine(&positions),
            positions,
            tried: Vec::new(),
        }
    }

    fn run(&mut self) {
        let base = vec![(Matrix3::identity(), Vector3::zeros()); self.positions.len()];
        self.outwards(0, &base, Path::default(), 0);
    }

    /// Number of quarter turns to try. Two zeros are not observable. That of the last joint is equivalent to a rotation of the target; that
    /// of the first joint is equivalent to a rotation of the base if the base is free.
    fn n_quarter_turns(&self, joint: usize, n_turned: usize) -> u8 {
        let is_seen = joint + 1 < self.links.len() && (joint > 0 || self.frame == Frame::Base);
        if is_seen && n_turned < self.most_turned {
            4
        } else {
            1
        }
    }

    /// Computes the frame of each link in turn, in the base's frame.
    fn outwards(&mut self, joint: usize, frames: &[LinkFrame], path: Path, n_turned: usize) {
        let Some((rotation, shift)) = self.fixed.get(joint).copied() else {
            let cost_mm2 = self.cost_mm2(frames);
            self.tried.push(Tried { cost_mm2, path });
            return;
        };
        let d_mm = self.links[joint].d_mm;
        let before: Vec<LinkFrame> = frames
            .iter()
            .map(|(r, t)| (r * rotation, t + r * shift))
            .collect();
        for turning in 0..self.turnings[joint].len() {
            for turns in 0..self.n_quarter_turns(joint, n_turned) {
                let of_link = |((r, t), sine_cosine): (&LinkFrame, &(f64, f64))| {
                    let (s, c) = turned(*sine_cosine, turns);
                    let (x, y, z) = (r.column(0), r.column(1), r.column(2));
                    let turned =
                        Matrix3::from_columns(&[x * c + y * s, y * c - x * s, z.into_owned()]);
                    (turned, t + z * d_mm)
                };
                let angles = &self.turnings[joint][turning].sine_cosine;
                let after: Vec<_> = before.iter().zip(angles).map(of_link).collect();
                let path = path.with(joint, turning, turns);
                self.outwards(joint + 1, &after, path, n_turned + usize::from(turns > 0));
            }
        }
    }

    /// Misfit of the flanges (in the base frame) to the measured points, mm². With a known base and the right convention, all points
    /// coincide in the flange frame.
    fn cost_mm2(&self, flanges: &[LinkFrame]) -> f64 {
        match self.frame {
            Frame::Base => {
                let measured = flanges.iter().zip(&self.positions);
                let in_flange: Vec<Vector3<f64>> =
                    measured.map(|((r, t), p)| r.tr_mul(&(p - t))).collect();
                scatter_mm2(&in_flange)
            }
            Frame::Instrument => affine_cost_mm2(&self.beyond_affine, flanges),
        }
    }

    fn convention(&self, path: &Path) -> Convention {
        let n = self.links.len();
        let of = |joint: usize| &self.turnings[joint][path.turning(joint)];
        let reversed: Vec<bool> = (0..n).map(|joint| of(joint).reversed).collect();
        let coupling = match n {
            3.. if reversed[1] => -of(2).of_joint_2,
            3.. => of(2).of_joint_2,
            _ => 0.0,
        };
        Convention {
            reversed,
            coupling: coupling + 0.0,
            quarter_turns: (0..n).map(|joint| path.quarter_turns(joint)).collect(),
        }
    }
}

impl Path {
    fn with(mut self, joint: usize, turning: usize, quarter_turns: u8) -> Self {
        self.0[joint] = 4 * turning as u8 + quarter_turns;
        self
    }

    fn turning(&self, joint: usize) -> usize {
        usize::from(self.0[joint] / 4)
    }

    fn quarter_turns(&self, joint: usize) -> u8 {
        self.0[joint] % 4
    }
}

/// Sine and cosine of an angle with quarter turns added.
fn turned((s, c): (f64, f64), quarter_turns: u8) -> (f64, f64) {
    match quarter_turns {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

/// The possible directions and couplings of a joint: both directions; for joint 3, each with every coupling to joint 2.
fn turnings(links: &[Link], compared: &[Observation], joint: usize) -> Vec<Turning> {
    let couplings = if joint == 2 { &COUPLINGS[..] } else { &[0.0] };
    let turning = |reversed: bool, of_joint_2: f64| {
        let angle_rad = |o: &Observation| {
            let own = if reversed {
                -o.q_rad[joint]
            } else {
                o.q_rad[joint]
            };
            let other = if of_joint_2 == 0.0 {
                0.0
            } else {
                of_joint_2 * o.q_rad[1]
            };
            own + other + links[joint].theta_offset_rad
        };
        Turning {
            reversed,
            of_joint_2,
            sine_cosine: compared
                .iter()
                .map(|o| libm::sincos(angle_rad(o)))
                .collect(),
        }
    };
    [false, true]
        .into_iter()
        .flat_map(|reversed| couplings.iter().map(move |coupling| (reversed, *coupling)))
        .map(|(reversed, coupling)| turning(reversed, coupling))
        .collect()
}
