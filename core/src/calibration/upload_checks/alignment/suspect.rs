//! A set that the nominal robot does not fit: possible causes, how well the robot then fits, and the messages.

use super::convention::Convention;
use super::explanation::{
    BETTER, Explanation, FITS, NEAR_FIT_PER_REACH, Suspicion, UNMASTERED_RAD, observations,
    of_one_station,
};
use super::fitting::{
    Fitted, Zeroed, placed, placed_thoroughly, quickly_placed, reach_mm, spread_mm, with_free_zeros,
};
use super::hypotheses::{Hypothesis, hypotheses};
use super::joint_maps;
use super::texts::{in_words, mm, names_first_joint, offsets};
use crate::identification::model::objective::Observation;
use crate::kinematics::Robot;
use crate::measurement::{Frame, MeasurementSet, Point};
use std::collections::BTreeSet;

/// Hypotheses whose rms differ by less than this factor fit equally well. The most likely one is reported.
const EQUALLY_GOOD: f64 = 2.0;
/// A hypothesis whose rms exceeds this share of the spread of its points explains nothing: with smaller units, points and joints hardly move, and
/// any robot is near them.
const MAX_PER_SPREAD: f64 = 0.1;
/// Maximum number of hypotheses that are fitted thoroughly.
const MAX_REFITTED: usize = 8;
/// Minimum number of distinct poses for refusing a set that nothing explains.
const MIN_POSES: usize = 5;
/// The direction of a joint that moves less than this is unknown, rad (20°).
const SMALL_JOINT_RANGE_RAD: f64 = 0.349;
/// Maximum number of joints for trying all signs.
const MAX_JOINTS: usize = 7;
/// Minimum number of distinct poses for stating that other signs fit as well.
const MIN_FOR_SIGNS: usize = 12;

/// A possible cause, and how well the robot then fits.
pub struct Candidate {
    pub cause: Cause,
    pub rms_mm: f64,
    /// Another cause with the same effect: a left-handed file, or joints that are counted in the opposite direction.
    pub or: Option<Cause>,
    /// Joint zero errors in addition.
    pub zeros: Option<Zeroed>,
}

impl Candidate {
    fn new(cause: Cause, rms_mm: f64) -> Self {
        Self {
            cause,
            rms_mm,
            or: None,
            zeros: None,
        }
    }
}

/// A possible cause.
pub enum Cause {
    File(Hypothesis),
    Joints(Box<Convention>),
}

impl Cause {
    /// True for a file in a left-handed frame.
    fn is_left_handed(&self) -> bool {
        matches!(self, Self::File(file) if file.is_left_handed())
    }

    /// True for a convention with zeros shifted by quarter turns.
    pub fn is_turned(&self) -> bool {
        matches!(self, Self::Joints(convention) if convention.is_turned())
    }

    /// True for a convention whose first zero is shifted by quarter turns. It is equivalent to a rotated base frame.
    pub fn turns_first_joint(&self) -> bool {
        matches!(self, Self::Joints(convention) if convention.quarter_turns.first().is_some_and(|turns| *turns > 0))
    }

    /// Rank by likelihood. Of the causes that fit equally well, the one with the smallest rank is reported. On most arms a left-handed
    /// frame and a maker's signs are equivalent, and makers do use these signs. Turned zeros are rarer than exchanged columns.
    pub fn rank(&self, frame: Frame) -> usize {
        match self {
            Self::File(Hypothesis::Units { .. }) => 0,
            Self::File(Hypothesis::Robot(_)) => 5,
            Self::File(Hypothesis::PositionColumns(_)) if frame == Frame::Base => 1,
            Self::File(_) if self.is_left_handed() => 3,
            Self::File(_) => 1,
            Self::Joints(_) if frame == Frame::Base && self.is_turned() => 4,
            Self::Joints(_) => 2,
        }
    }
}

/// A set that the nominal robot does not fit.
pub(super) struct Suspect<'a> {
    robot: &'a Robot,
    frame: Frame,
    points: Vec<Point>,
    observations: Vec<Observation>,
    off_mm: f64,
    /// Limits of the rms by [`FITS`] and [`NEAR_FIT_PER_REACH`], mm.
    pub fits_mm: f64,
    /// See `fits_mm`.
    pub near_mm: f64,
}

impl<'a> Suspect<'a> {
    pub fn new(robot: &'a Robot, set: &MeasurementSet, off_mm: f64) -> Self {
        let points = of_one_station(set);
        let observations = observations(robot, &points);
        let reach_mm = reach_mm(&robot.links, &observations);
        Self {
            robot,
            frame: set.frame,
            points,
            observations,
            off_mm,
            fits_mm: FITS * reach_mm,
            near_mm: NEAR_FIT_PER_REACH * reach_mm,
        }
    }

    pub fn zeros(&self, frame: Frame) -> Option<Zeroed> {
        // An rms of half the limit is good enough; no other start is needed.
        with_free_zeros(
            &self.robot.links,
            &self.observations,
            frame,
            0.5 * self.fits_mm,
        )
    }

    /// True if both fit equally well.
    pub fn are_equal(free: &Fitted, candidate: &Candidate) -> bool {
        free.rms_mm <= EQUALLY_GOOD * candidate.rms_mm
    }

    /// The fit if the positions are in an instrument's frame.
    pub fn in_another_frame(&self) -> Option<Fitted> {
        placed_thoroughly(&self.robot.links, &self.observations, Frame::Instrument)
            .filter(|free| free.rms_mm <= self.fits_mm)
    }

    fn convention(&self, frame: Frame) -> Option<Candidate> {
        let (convention, fitted) =
            joint_maps::search(&self.robot.links, &self.observations, frame, self.fits_mm)?;
        let cause = Cause::Joints(Box::new(convention));
        Some(Candidate::new(cause, fitted.rms_mm))
    }

    /// A convention that fits if joints may also be unmastered.
    pub fn convention_and_zeros(&self, frame: Frame) -> Option<Candidate> {
        let links = &self.robot.links;
        let (convention, zeros) =
            joint_maps::search_with_zeros(links, &self.observations, frame, self.fits_mm)?;
        let cause = Cause::Joints(Box::new(convention));
        let candidate = Candidate::new(cause, zeros.rms_mm);
        Some(Candidate {
            zeros: Some(zeros),
            ..candidate
        })
    }

    /// The most likely of the best-fitting hypotheses.
    pub fn best_hypothesis(&self, others: &[(String, Robot)]) -> Option<Candidate> {
        let mut quick: Vec<(f64, Hypothesis)> = hypotheses(self.robot.links.len(), others.len())
            .into_iter()
            .filter_map(|hypothesis| {
                let (robot, observations) = self.under(&hypothesis, others);
                Some((
                    quickly_placed(&robot.links, &observations, self.frame)?.rms_mm,
                    hypothesis,
                ))
            })
            .collect();
        quick.sort_by(|a, b| a.0.total_cmp(&b.0));
        quick.truncate(MAX_REFITTED);
        let thoroughly = |(_, hypothesis): (f64, Hypothesis)| {
            let (robot, observations) = self.under(&hypothesis, others);
            let rms_mm = placed(&robot.links, &observations, self.frame)?.rms_mm;
            let is_fit = rms_mm <= MAX_PER_SPREAD * spread_mm(&observations);
            is_fit.then(|| Candidate::new(Cause::File(hypothesis), rms_mm))
        };
        let mut all: Vec<Candidate> = quick.into_iter().filter_map(thoroughly).collect();
        all.extend(self.convention(self.frame));
        let best_mm = all.iter().map(|s| s.rms_mm).fold(f64::INFINITY, f64::min);
        all.retain(|candidate| candidate.rms_mm <= EQUALLY_GOOD * best_mm);
        all.sort_by(|a, b| {
            let order = a.cause.rank(self.frame).cmp(&b.cause.rank(self.frame));
            order.then(a.rms_mm.total_cmp(&b.rms_mm))
        });
        let mut all = all.into_iter();
        let mut likeliest = all.next()?;
        let looks_the_same = |other: &Candidate| match &likeliest.cause {
            Cause::Joints(_) => other.cause.is_left_handed(),
            cause => cause.is_left_handed() && matches!(other.cause, Cause::Joints(_)),
        };
        let or = all.find(|other| looks_the_same(other));
        likeliest.or = or.map(|other| other.cause);
        Some(likeliest)
    }

    fn under<'b>(
        &'b self,
        hypothesis: &Hypothesis,
        others: &'b [(String, Robot)],
    ) -> (&'b Robot, Vec<Observation>) {
        let robot = hypothesis
            .robot()
            .map_or(self.robot, |index| &others[index].1);
        (
            robot,
            observations(robot, &hypothesis.applied(&self.points)),
        )
    }

    /// The refusal for a hypothesis that fits.
    pub fn suspicion(&self, candidate: &Candidate, others: &[(String, Robot)]) -> Suspicion {
        let (off_mm, found_mm) = (mm(self.off_mm), mm(candidate.rms_mm));
        let as_it_is = format!(
            "as it is, the nominal robot fits these points only to {off_mm} mm (rms, best alignment)"
        );
        match &candidate.cause {
            Cause::File(hypothesis) => {
                let names: Vec<&str> = others.iter().map(|(name, _)| name.as_str()).collect();
                let (words, hint) = (hypothesis.words(&names), hypothesis.hint());
                let alone = match hypothesis.is_left_handed() {
                    true => {
                        ". Joints that are counted the other way round may look the same: compare the controller's joint values with the nominal robot \
                         before columns are exchanged, or a mirrored robot is identified"
                    }
                    false => "",
                };
                let or = match &candidate.or {
                    Some(Cause::Joints(convention)) => format!(
                        ". It fits as well if {}: then the robot's joint_map is {}. Look at the controller which of both it is: with the wrong one a \
                         mirrored robot is identified",
                        convention.words(self.robot),
                        in_words(&convention.joint_map(self.robot))
                    ),
                    _ => alone.to_owned(),
                };
                suspicion(
                    hypothesis.code(),
                    hypothesis.columns(),
                    format!("{as_it_is}; if {words}, it fits to {found_mm} mm: {hint}{or}"),
                )
            }
            Cause::Joints(convention) => {
                let map = convention.joint_map(self.robot);
                let map_text = in_words(&map);
                let off = candidate.zeros.as_ref().and_then(offsets);
                let also = off.map_or(String::new(), |off| {
                    format!(" and joint values are off by {off}")
                });
                let words = convention.words(self.robot) + &also;
                let or_file = match (&candidate.or, self.frame) {
                    (Some(Cause::File(file)), Frame::Base) => Some(file.words(&[])),
                    (Some(Cause::File(_)), Frame::Instrument) => {
                        Some("the file's frame is left-handed".into())
                    }
                    _ => None,
                };
                let or = or_file.map_or(String::new(), |words| {
                    format!(
                        ". It fits as well if {words}: then export in a right-handed frame. Look at the controller which of both it is: with the wrong one a \
                         mirrored robot is identified"
                    )
                });
                let sees_last_direction = candidate.zeros.is_some()
                    || self.sees_last_direction(convention, candidate.rms_mm);
                let other = self.other_signs(convention, candidate.rms_mm);
                let or_signs = other.as_ref().map_or(String::new(), |other| {
                    let differs = |joint: &usize| {
                        convention.reversed[*joint] != other.reversed[*joint]
                    };
                    let joint = (0..self.robot.links.len()).find(differs).unwrap_or(0) + 1;
                    format!(
                        ". It fits as well if {}: then the joint_map is {}, and the base is turned otherwise. These points cannot tell which of both it \
                         is: move joint {joint} alone at the controller and look which way it turns, or measure in the base frame",
                        other.words(self.robot),
                        in_words(&other.joint_map(self.robot))
                    )
                });
                let unseen = match sees_last_direction {
                    true => String::new(),
                    false => format!(
                        ". Which way joint {} counts cannot be seen in these points: look at the controller",
                        self.robot.links.len()
                    ),
                };
                let detail = format!(
                    "{as_it_is}; if {words}, it fits to {found_mm} mm: if the controller counts so, the robot's joint_map is {map_text}{unseen}{or_signs}{or}"
                );
                Suspicion {
                    joint_map: other.is_none().then_some(map),
                    ..suspicion("joint_map_suspect", Some(convention.columns()), detail)
                }
            }
        }
    }

    /// Other signs with which the points fit as well, because the arm is symmetric: rotating a free base by 180° is equivalent to reversing
    /// joints. `None` for few points, which several conventions fit by chance.
    fn other_signs(&self, convention: &Convention, rms_mm: f64) -> Option<Convention> {
        let n = self.robot.links.len();
        let is_simple = convention.coupling == 0.0 && !convention.is_turned();
        let is_few = self.n_poses() < MIN_FOR_SIGNS;
        if self.frame == Frame::Base || !is_simple || n > MAX_JOINTS || is_few {
            return None;
        }
        // Points do not show the direction of a joint that hardly moves. If only that of the last joint is unknown, this is reported
        // separately.
        let moves = |joint: usize| {
            let values = self.observations.iter().map(|o| o.q_rad[joint]);
            let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), q| {
                (low.min(q), high.max(q))
            });
            high - low >= SMALL_JOINT_RANGE_RAD
        };
        let moving: usize = (0..n).map(|joint| usize::from(moves(joint)) << joint).sum();
        let last = 1 << (n - 1);
        let with = |pattern: usize| Convention {
            reversed: (0..n)
                .map(|joint| convention.reversed[joint] ^ (pattern >> joint & 1 == 1))
                .collect(),
            ..convention.clone()
        };
        let fits = |other: &Convention| {
            let points = other.observations(&self.observations);
            quickly_placed(&self.robot.links, &points, self.frame)
                .is_some_and(|found| found.rms_mm <= EQUALLY_GOOD * rms_mm)
        };
        (1..1 << n)
            .filter(|pattern| *pattern != last && pattern & !moving == 0)
            .map(with)
            .filter(|other| other.complexity() > 0)
            .find(fits)
    }

    /// The refusal if another frame and another joint convention fit equally well.
    pub fn frame_or_joints(&self, free: &Fitted, convention: &Convention) -> Explanation {
        let frame = match self.frame(free, "") {
            Explanation::Refusal(suspicion) => suspicion.detail,
            Explanation::Warning { detail, .. } => detail,
        };
        let detail = format!(
            "{frame}. It fits as well if {}: then the robot's joint_map is {}. Look at the controller which of both it is: with the wrong one the base is turned",
            convention.words(self.robot),
            in_words(&convention.joint_map(self.robot))
        );
        Explanation::Refusal(suspicion("frame_suspect", None, detail))
    }

    /// True if the points would fit worse with the last joint reversed.
    fn sees_last_direction(&self, convention: &Convention, rms_mm: f64) -> bool {
        let other = convention
            .with_last_reversed()
            .observations(&self.observations);
        placed(&self.robot.links, &other, self.frame)
            .is_none_or(|other| other.rms_mm > EQUALLY_GOOD * rms_mm)
    }

    /// Positions in another frame. The set is refused if they are far off; otherwise the base frame is poorly known, and there is a warning.
    pub fn frame(&self, free: &Fitted, also: &str) -> Explanation {
        let base = &free.model.t_instrument_base;
        let (at, turned_deg) = (base.translation.vector, base.rotation.angle().to_degrees());
        let detail = format!(
            "read in the robot's base frame, the nominal robot fits these points only to {} mm (rms); in another frame{also} it fits to {} mm, \
             with the robot's base at ({:.0}, {:.0}, {:.0}) mm, turned by {turned_deg:.1}°",
            mm(self.off_mm),
            mm(free.rms_mm),
            at.x,
            at.y,
            at.z
        );
        if self.off_mm <= self.near_mm {
            return Explanation::Warning {
                code: "frame_suspect",
                detail: format!(
                    "{detail}: check the base frame, or read them in the frame instrument"
                ),
            };
        }
        let detail = format!(
            "{detail}: these are positions in the instrument's frame; read them in the frame instrument"
        );
        Explanation::Refusal(suspicion("frame_suspect", None, detail))
    }

    /// Another frame, together with joint zero errors or another joint convention.
    pub fn frame_and_joints(&self) -> Option<Explanation> {
        let free = placed(&self.robot.links, &self.observations, Frame::Instrument)?;
        let with = |rms_mm: f64| Fitted {
            rms_mm,
            model: free.model.clone(),
        };
        let fits = |rms_mm: f64| rms_mm <= self.fits_mm && BETTER * rms_mm <= self.off_mm;
        if let Some(zeros) = self
            .zeros(Frame::Instrument)
            .filter(|zeros| fits(zeros.rms_mm) && zeros.largest_rad() <= UNMASTERED_RAD)
        {
            let also = format!(
                ", and with joint values that are off by {}",
                offsets(&zeros)?
            );
            return Some(self.frame(&with(zeros.rms_mm), &also));
        }
        let candidate = self
            .convention(Frame::Instrument)
            .filter(|found| fits(found.rms_mm))
            .or_else(|| self.convention_and_zeros(Frame::Instrument))
            .filter(|found| fits(found.rms_mm))?;
        let Cause::Joints(convention) = &candidate.cause else {
            return None;
        };
        let off = candidate.zeros.as_ref().and_then(offsets);
        let off = off.map_or(String::new(), |off| {
            format!(", with joint values that are off by {off}")
        });
        let also = format!(", and if {}{off}", convention.words(self.robot));
        Some(self.frame(&with(candidate.rms_mm), &also))
    }

    /// Warning that names joints that were probably never mastered. A base frame that is rotated about axis 1 is equivalent to a zero error
    /// of joint 1.
    pub fn unmastered(&self, zeros: &Zeroed) -> Option<Explanation> {
        let off = offsets(zeros)?;
        let why = match self.frame == Frame::Base && names_first_joint(zeros) {
            true => {
                "joint 1 was not mastered, or the positions are in a frame that is turned about axis 1, which looks the same: look whether joint 1 \
                 stands at its mark at 0°, and if it does, read them in the frame instrument"
            }
            false => "an unmastered joint?",
        };
        let detail = format!(
            "the nominal robot fits these points only to {} mm; with joint values that are off by {off} it fits to {} mm: {why}",
            mm(self.off_mm),
            mm(zeros.rms_mm)
        );
        Some(Explanation::Warning {
            code: "joint_offset_suspect",
            detail,
        })
    }

    /// Number of distinct poses of the arm. Repeated poses give no further information about the robot.
    fn n_poses(&self) -> usize {
        let poses: BTreeSet<Vec<u64>> = self
            .observations
            .iter()
            .map(|o| o.q_rad.iter().map(|q| q.to_bits()).collect())
            .collect();
        poses.len()
    }

    /// The result if no hypothesis explains the set.
    pub fn poor(&self, zeros: Option<&Zeroed>) -> Explanation {
        let nearest_mm = zeros.map_or(self.off_mm, |zeros| zeros.rms_mm.min(self.off_mm));
        let detail = format!(
            "the nominal robot fits these points only to {} mm (rms, best alignment), with other joint zeros to {} mm; right data fit \
             to {} mm",
            mm(self.off_mm),
            mm(nearest_mm),
            mm(self.fits_mm)
        );
        if zeros.is_none() || nearest_mm <= self.fits_mm || self.n_poses() < MIN_POSES {
            return Explanation::Warning {
                code: "poor_alignment",
                detail,
            };
        }
        let detail = format!(
            "{detail}, and none of the other frames, units, orders of columns and joint conventions that were tried does better: is it this robot, \
             and do the joint values and the position of each row belong together?"
        );
        Explanation::Refusal(suspicion("poor_alignment", None, detail))
    }
}

fn suspicion(code: &'static str, columns: Option<String>, detail: String) -> Suspicion {
    Suspicion {
        code,
        columns,
        detail,
        joint_map: None,
    }
}
