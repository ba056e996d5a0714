//! Simulated campaigns whose joint values err: joints with play, values that were read before the arm had settled, and the scatter of any robot.

use super::data::paper_robot;
use super::drifts::{Counts, NOISE_MM, counts_of, told_of};
use super::simulation::{Normal, limited, poses, true_robot};
use kincal::kinematics::Robot;
use kincal::measurement::{Frame, MeasurementSet, Point};
use rand::RngExt;
use rand::seq::SliceRandom;

/// Configurations of a campaign.
pub const CONFIGURATIONS: usize = 30;
/// Targets of a campaign with several.
pub const TARGETS: usize = 3;
/// Play, degrees.
pub const PLAY_DEG: f64 = 0.03;
/// Smallest and largest error of a joint value that was read too early, degrees.
pub const UNSETTLED_DEG: (f64, f64) = (0.01, 0.03);
/// Scatter of each joint of any robot, degrees.
pub const SCATTER_DEG: f64 = 0.001;

/// How the joint values of a campaign err.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointErrors {
    /// Each pose is visited twice, from above and from below in turn; the poses before are not in the file.
    PlayInTurn { joint: usize },
    /// Each pose is visited twice, in random order: the row before says from which side.
    PlayByOrder { joint: usize },
    /// As [`Self::PlayByOrder`], without play.
    Repeats,
    /// Several targets, and each configuration's joint values off by a random error.
    Unsettled,
    /// Several targets, without errors.
    Settled,
    /// Several targets, and the arm sags.
    Sag,
    /// Several targets, and the scatter of any robot.
    Scatter,
}

impl JointErrors {
    pub const ALL: [Self; 9] = [
        Self::PlayInTurn { joint: 1 },
        Self::PlayInTurn { joint: 2 },
        Self::PlayByOrder { joint: 1 },
        Self::PlayByOrder { joint: 2 },
        Self::Repeats,
        Self::Unsettled,
        Self::Settled,
        Self::Sag,
        Self::Scatter,
    ];

    pub fn name(self) -> String {
        let (least, most) = UNSETTLED_DEG;
        match self {
            Self::PlayInTurn { joint } => {
                format!(
                    "play of {PLAY_DEG}\u{b0} of joint {}, two visits from both sides in turn",
                    joint + 1
                )
            }
            Self::PlayByOrder { joint } => {
                format!(
                    "play of {PLAY_DEG}\u{b0} of joint {}, two visits in random order",
                    joint + 1
                )
            }
            Self::Repeats => "two visits in random order, no play".into(),
            Self::Unsettled => {
                format!(
                    "{TARGETS} targets, joint values of each configuration off by {least}\u{b0} to {most}\u{b0}"
                )
            }
            Self::Settled => format!("{TARGETS} targets, clean"),
            Self::Sag => format!("{TARGETS} targets, sag of 0.4 mm (rms)"),
            Self::Scatter => format!("{TARGETS} targets, joints scatter by {SCATTER_DEG}\u{b0}"),
        }
    }
}

/// The set.
pub fn campaign(errors: JointErrors, seed: u64) -> (Robot, MeasurementSet) {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(8_000_000 + seed);
    let n_targets = match errors {
        JointErrors::PlayInTurn { .. } | JointErrors::PlayByOrder { .. } | JointErrors::Repeats => {
            1
        }
        _ => TARGETS,
    };
    let truth = true_robot(&nominal, n_targets, &mut random);
    let all = poses(CONFIGURATIONS, &mut random);
    let n_visits = if n_targets == 1 { 2 } else { 1 };
    let mut visits: Vec<usize> = (0..CONFIGURATIONS * n_visits)
        .map(|k| k / n_visits)
        .collect();
    if matches!(
        errors,
        JointErrors::PlayByOrder { .. } | JointErrors::Repeats
    ) {
        visits.shuffle(&mut random.0);
    }
    let play_rad = PLAY_DEG.to_radians();
    let mut points: Vec<Point> = Vec::new();
    let mut side = 1.0;
    for (k, configuration) in visits.iter().enumerate() {
        let q = &all[*configuration];
        let mut actual = q.clone();
        match errors {
            JointErrors::PlayInTurn { joint } => {
                actual[joint] += if k % 2 == 0 { 0.5 } else { -0.5 } * play_rad;
            }
            JointErrors::PlayByOrder { joint } => {
                let before = k.checked_sub(1).map_or(q, |before| &all[visits[before]]);
                if q[joint] != before[joint] {
                    side = (q[joint] - before[joint]).signum();
                }
                actual[joint] -= 0.5 * side * play_rad;
            }
            JointErrors::Unsettled => {
                let (least, most) = UNSETTLED_DEG;
                for q in &mut actual {
                    let size = random.0.random_range(least..most).to_radians();
                    *q += if random.0.random() { size } else { -size };
                }
            }
            JointErrors::Scatter => {
                actual
                    .iter_mut()
                    .for_each(|q| *q += random.draw() * SCATTER_DEG.to_radians());
            }
            JointErrors::Repeats | JointErrors::Settled | JointErrors::Sag => {}
        }
        let sag_rad = if errors == JointErrors::Sag {
            2e-4
        } else {
            0.0
        };
        for target in 0..n_targets {
            let true_mm = super::simulation::position_with_sag(&truth, &actual, target, sag_rad);
            points.push(Point {
                q_rad: q.clone(),
                position_mm: true_mm + random.vector() * NOISE_MM,
                configuration: format!("c{configuration}"),
                target,
                ..Point::empty(6, points.len())
            });
        }
    }
    (nominal, MeasurementSet::new(Frame::Instrument, points))
}

/// Of some campaigns, what was told.
pub fn counts(errors: JointErrors, seeds: std::ops::Range<u64>) -> Counts {
    counts_of(seeds.map(|seed| {
        let (robot, set) = campaign(errors, seed);
        told_of(robot, set, None)
    }))
}
