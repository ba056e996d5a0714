//! Few or noisy poses: of one session, of two sessions as one job, and of a camera that the arm carries. What is found stands beside the attainable: the most
//! probable robot of all poses with the true noise and the true scatter of links, and with the true motion between the sessions.

use crate::data::paper_robot;
use crate::poses::{LIMITS_DEG, Noise, TRACKED, measured, truth};
use crate::simulation::{Normal, found};
use kincal::calibration::request::CorrectionsChoice;
use kincal::calibration::session_comparison::estimate;
use kincal::calibration::{
    CalibrationReport, CalibrationRequest, CheckVerdict, Error, HeldOut, NO_FIT, ReleasedSet,
    calibrate, check_released,
};
use kincal::identification::KinematicModel;
use kincal::identification::corrections::corrected::IdentifiedRobot;
use kincal::identification::least_squares::estimate::most_probable;
use kincal::identification::least_squares::evidence::Evidence;
use kincal::identification::least_squares::problem::{Problem, Unknown};
use kincal::identification::least_squares::start::fit_base_and_targets;
use kincal::identification::model::objective::Observation;
use kincal::identification::model::parameters::{
    Parameter, complete_parameters, target_rotation_parameters,
};
use kincal::identification::model::pose_rows::MeasuredRotation;
use kincal::kinematics::rotation::rotation_exp;
use kincal::measurement::sessions::joined;
use kincal::measurement::{Frame, MeasurementSet, Point};
use kincal::solvers::watch::Watch;
use std::ops::ControlFlow;

/// Poses of a board as a camera on the flange sees it. The noise is that of the board in the camera's frame.
fn seen_by_a_carried_camera(
    truth: &KinematicModel,
    n: usize,
    noise: Noise,
    random: &mut Normal,
) -> MeasurementSet {
    let points = (0..n).map(|row| {
        let q_rad = random.pose(&LIMITS_DEG);
        let back = truth.rotation(&q_rad, 0).unwrap().inverse();
        let turned = rotation_exp(&(random.vector() * noise.rotation_rad));
        Point {
            position_mm: -(back * truth.position(&q_rad, 0)) + random.vector() * noise.position_mm,
            rotation: Some(back * turned),
            q_rad,
            ..Point::empty(6, row)
        }
    });
    MeasurementSet::new(Frame::Instrument, points.collect()).with_inverse_poses()
}

/// A robot in one session, or in two with another base and another target in each.
struct Case {
    truths: Vec<KinematicModel>,
    sets: Vec<MeasurementSet>,
    noise: Noise,
}

type Measure = fn(&KinematicModel, usize, Noise, &mut Normal) -> MeasurementSet;

impl Case {
    fn new(seed: u64, sizes: &[usize], noise: Noise, measure: Measure) -> Self {
        let mut random = Normal::new(seed);
        let first = truth(&paper_robot(), &mut random);
        let (mut truths, mut sets) = (vec![], vec![]);
        for n in sizes {
            let mut truth = match truths.is_empty() {
                true => first.clone(),
                false => truth(&paper_robot(), &mut random),
            };
            truth.links = first.links.clone();
            sets.push(measure(&truth, *n, noise, &mut random));
            truths.push(truth);
        }
        Self {
            truths,
            sets,
            noise,
        }
    }

    fn run(&self) -> Result<CalibrationReport, Error> {
        let mut request = match self.sets.as_slice() {
            [only] => CalibrationRequest::new(paper_robot(), only.clone()),
            several => CalibrationRequest {
                sessions: several.to_vec(),
                ..CalibrationRequest::new(paper_robot(), joined(several))
            },
        };
        request.corrections = Some(CorrectionsChoice::Off);
        calibrate(&request, &mut |_| ControlFlow::Continue(()))
    }

    /// rms distance from the true positions at unseen configurations, as the last session sees them, mm.
    fn unseen_mm(&self, found: &KinematicModel) -> f64 {
        let (last, mut random) = (self.truths.len() - 1, Normal::new(77));
        let squares = (0..200).map(|_| {
            let q = random.pose(&LIMITS_DEG);
            let truth = self.truths[last].position(&q, 0);
            (found.position(&q, last) - truth).norm_squared()
        });
        (squares.sum::<f64>() / 200.0).sqrt()
    }

    fn attainable_mm(&self) -> f64 {
        let (robot, n_targets) = (paper_robot(), self.sets.len());
        let reference = self.truths[n_targets - 1].t_instrument_base;
        let mut points = vec![];
        for (target, (set, truth)) in self.sets.iter().zip(&self.truths).enumerate() {
            let motion = reference * truth.t_instrument_base.inverse();
            points.extend(set.points.iter().map(|p| {
                let rotation = p.rotation.map(|rotation| MeasuredRotation {
                    rotation,
                    mm_per_rad: self.noise.position_mm / self.noise.rotation_rad,
                    lever_mm: p.lever_mm,
                });
                let q_rad = robot.q_model_rad(&p.q_rad);
                let position = Observation::at(q_rad, p.position_mm, target);
                Observation {
                    rotation,
                    ..position
                }
                .moved(&motion)
            }));
        }
        let start = fit_base_and_targets(&robot.links, &points, n_targets);
        let mut parameters = complete_parameters(6, n_targets);
        let all: Vec<usize> = (0..n_targets).collect();
        parameters.extend(target_rotation_parameters(&all));
        let problem = Problem::new(start.clone(), &parameters, &points);
        let mut evidence = Evidence::first(&problem, self.noise.position_mm);
        for (width, variable) in evidence.widths.iter_mut().zip(&problem.variables) {
            let std = |p: &Parameter| match p.is_angle() {
                true => 0.05f64.to_radians(),
                false => 0.3,
            };
            if let Unknown::Parameter(parameter) = &variable.unknown
                && parameter.is_link()
            {
                *width = std(parameter) / variable.width;
            }
        }
        let model = most_probable(&problem, &start, &evidence, &Watch::nobody()).model;
        self.unseen_mm(&model)
    }
}

/// What came of the cases of some seeds.
struct Outcome {
    /// Seeds that were refused or told `no_fit`.
    refused: Vec<u64>,
    found_mm: Vec<f64>,
    attainable_mm: Vec<f64>,
}

fn median(values: &[f64]) -> f64 {
    values[values.len() / 2]
}

fn outcome(seeds: std::ops::Range<u64>, case: impl Fn(u64) -> Case) -> Outcome {
    let (mut refused, mut found_mm, mut attainable_mm) = (vec![], vec![], vec![]);
    for seed in seeds {
        let case = case(seed);
        attainable_mm.push(case.attainable_mm());
        match case.run() {
            Ok(report) => {
                found_mm.push(case.unseen_mm(&found(&report)));
                let is_no_fit = report.warnings.iter().any(|told| told.code == NO_FIT);
                refused.extend(is_no_fit.then_some(seed));
            }
            Err(_) => refused.push(seed),
        }
    }
    found_mm.sort_by(f64::total_cmp);
    attainable_mm.sort_by(f64::total_cmp);
    println!(
        "refused {refused:?}; median {:.3} mm, largest {:.3}; attainable {:.3}, {:.3}",
        median(&found_mm),
        found_mm[found_mm.len() - 1],
        median(&attainable_mm),
        attainable_mm[attainable_mm.len() - 1]
    );
    Outcome {
        refused,
        found_mm,
        attainable_mm,
    }
}

/// How much more than the attainable error one session may leave, median over seeds: noise and widths are estimated, and half of the poses is held out first.
const OF_ONE_SESSION: f64 = 1.1;
/// Of two sessions. The attainable knows the six numbers of the motion between them.
const OF_TWO_SESSIONS: f64 = 1.5;

/// Five poses give as many equations as there are combinations, and leave no rest. The noise came out as zero, the held-out half was missed by centimetres, and
/// 18 of these 40 draws ended in `no_fit`.
#[test]
fn ten_poses_with_ordinary_noise_fit_their_robot_in_every_draw() {
    let found = outcome(2000..2040, |seed| Case::new(seed, &[10], TRACKED, measured));
    assert_eq!(found.refused, [] as [u64; 0]);
    assert!(median(&found.found_mm) < OF_ONE_SESSION * median(&found.attainable_mm));
}

/// Sessions of one robot are refused as different ones in 1 % of all cases, and short sessions more often than that (docs/poses.md).
const MOST_REFUSED: usize = 1;

/// The motion between the sessions came from positions alone, which are too few here: 587 mm off, and `no_fit` in 8 of 8 draws.
#[test]
fn two_sessions_of_a_few_poses_are_fitted_as_one_job() {
    for n in [6, 8] {
        let found = outcome(2000..2008, |seed| {
            Case::new(seed, &[n, n], TRACKED, measured)
        });
        let refused = &found.refused;
        assert!(refused.len() <= MOST_REFUSED, "{n} poses: {refused:?}");
        let attainable_mm = median(&found.attainable_mm);
        assert!(n < 8 || median(&found.found_mm) < OF_TWO_SESSIONS * attainable_mm);
    }
}

/// By chance, two of 24 are refused with a probability of 2 %.
#[test]
fn a_short_session_is_of_the_same_robot_as_a_long_one() {
    let found = outcome(2000..2024, |seed| {
        Case::new(seed, &[20, 6], TRACKED, measured)
    });
    assert!(found.refused.len() <= MOST_REFUSED, "{:?}", found.refused);
}

/// A camera sees a board a metre or two away to 0.1 mm and 2 mrad. Inverted, its position carries the rotation's error times that distance.
const CAMERA: Noise = Noise {
    position_mm: 0.1,
    rotation_rad: 2e-3,
};

/// Position and rotation were weighed as if they were independent: 1.81 mm, and `no_fit` in 7 of these 8 draws.
#[test]
fn a_carried_camera_is_weighed_where_it_sees_the_board() {
    let found = outcome(2000..2008, |seed| {
        Case::new(seed, &[25], CAMERA, seen_by_a_carried_camera)
    });
    assert_eq!(found.refused, [] as [u64; 0]);
    assert!(median(&found.found_mm) < OF_ONE_SESSION * median(&found.attainable_mm));
}

/// Of unchanged robots, one in a hundred is called changed; of six, two are with a probability of 0.2 %.
#[test]
fn quick_checks_by_noisy_poses_hold() {
    let coarse = Noise {
        position_mm: 0.1,
        rotation_rad: 3e-3,
    };
    for (measure, name) in [
        (measured as Measure, "tracker"),
        (seen_by_a_carried_camera, "carried camera"),
    ] {
        let verdicts: Vec<CheckVerdict> = (2000..2006)
            .map(|seed| {
                let mut random = Normal::new(seed);
                let truth = truth(&paper_robot(), &mut random);
                let mut request = |n| {
                    CalibrationRequest::new(paper_robot(), measure(&truth, n, coarse, &mut random))
                };
                let (mut identified, check) = (request(40), request(10));
                identified.corrections = Some(CorrectionsChoice::Off);
                let verify = calibrate(&identified, &mut |_| ControlFlow::Continue(()))
                    .unwrap()
                    .verify
                    .unwrap();
                let estimate = estimate(&identified, &mut |_| ControlFlow::Continue(()))
                    .unwrap()
                    .unwrap();
                let robot = IdentifiedRobot::of_links(estimate.model.clone());
                let check = CalibrationRequest {
                    scored_frame: Some(Frame::Instrument),
                    held_out: Some(HeldOut {
                        nominal_rms_mm: verify.before.rms_mm,
                        identified_rms_mm: verify.after.rms_mm,
                    }),
                    ..check
                };
                let released = ReleasedSet {
                    robot: &robot,
                    estimate: Some(&estimate),
                    after: None,
                    is_measured_anew: true,
                    is_insisted_on: false,
                };
                let report =
                    check_released(&check, &released, &mut |_| ControlFlow::Continue(())).unwrap();
                report.quick_check.unwrap().verdict
            })
            .collect();
        println!("{name}: {verdicts:?}");
        let n_hold = verdicts
            .iter()
            .filter(|v| **v == CheckVerdict::Holds)
            .count();
        assert!(n_hold >= 5, "{name}: {n_hold} hold");
    }
}
