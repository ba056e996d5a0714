//! The stated uncertainties, compared with robots whose true parameters are known.

use crate::data::{paper_robot, paper_set, real_data, robot};
use crate::simulation::{
    Campaign, NonlinearErrors, Normal, found, identified, intervals_held, limited, links_alone,
    measure, poses, position_with_sag, robot_of_the_priors, tool_intervals_held, true_robot,
};
use kincal::calibration::request::{CorrectionsChoice, Loss};
use kincal::calibration::{CalibrationReport, CalibrationRequest, Method, Preset, calibrate};
use kincal::identification::KinematicModel;
use kincal::kinematics::t_base_flange;
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet, Subset};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::RngExt;
use std::ops::ControlFlow;
use std::sync::LazyLock;

/// Robots per test; `examples/study/coverage.rs` uses 1,000.
const ROBOTS: u64 = 80;

/// Robots with white noise alone, for the tests that share them.
static PLAIN: LazyLock<Vec<Run>> = LazyLock::new(|| runs(Campaign::PLAIN));

struct Run {
    truth: KinematicModel,
    report: CalibrationReport,
}

fn runs(campaign: Campaign) -> Vec<Run> {
    runs_of(campaign, |request| request)
}

/// The same, for the uncertainty of parameters alone.
fn runs_of_links(campaign: Campaign) -> Vec<Run> {
    runs_of(campaign, |request| links_alone(&request))
}

fn runs_of(
    campaign: Campaign,
    change: impl Fn(CalibrationRequest) -> CalibrationRequest,
) -> Vec<Run> {
    let run = |seed: u64| {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = robot_of_the_priors(&nominal, campaign.n_targets, &mut random);
        let set = measure(
            &truth,
            &poses(campaign.n_configurations, &mut random),
            &campaign,
            &mut random,
        );
        let request = CalibrationRequest {
            method: Method::LeastSquares,
            ..CalibrationRequest::new(nominal, set)
        };
        let request = change(request);
        Run {
            truth,
            report: calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap(),
        }
    };
    (0..ROBOTS).map(run).collect()
}

/// The same, with two points of each robot 5 mm off, and a robust loss.
fn robust_runs(loss: Loss) -> Vec<Run> {
    let run = |seed: u64| {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = robot_of_the_priors(&nominal, 1, &mut random);
        let mut set = measure(
            &truth,
            &poses(50, &mut random),
            &Campaign::PLAIN,
            &mut random,
        );
        for point in [11, 37] {
            set.points[point].position_mm += random.vector().normalize() * 5.0;
        }
        let mut request = CalibrationRequest {
            method: Method::LeastSquares,
            ..CalibrationRequest::new(nominal, set)
        };
        request.options.loss = Some(loss);
        let request = links_alone(&request);
        Run {
            truth,
            report: calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap(),
        }
    };
    (0..ROBOTS).map(run).collect()
}

#[test]
fn with_wild_points_and_a_robust_loss_the_intervals_are_those_of_the_other_points() {
    let mean_std = |runs: &[Run]| {
        let stds = runs
            .iter()
            .flat_map(|r| r.report.parameters.iter().filter_map(|p| p.std_uncertainty));
        let (sum, n) = stds.fold((0.0, 0), |(sum, n), std| (sum + std, n + 1));
        sum / f64::from(n)
    };
    let plain = mean_std(&PLAIN);
    for loss in [Loss::Huber, Loss::Tukey] {
        let runs = robust_runs(loss);
        let (held, wider) = (coverage(&runs), mean_std(&runs) / plain);
        println!("{loss:?}: {held:.2} % held, {wider:.3} times as wide as without wild points");
        // An efficiency of 95 % is 1.026 times the width; two of 50 points have an influence up to Huber's bound.
        assert!(
            (92.0..=97.0).contains(&held) && (0.95..1.3).contains(&wider),
            "{loss:?}: {held} %, {wider}"
        );
    }
}

/// Share of the stated 95 % intervals that contain the truth, %.
fn coverage(runs: &[Run]) -> f64 {
    let counts = runs
        .iter()
        .map(|r| intervals_held(&paper_robot(), &r.truth, &r.report));
    let (stated, held) = counts.fold((0, 0), |(s, h), (stated, held)| (s + stated, h + held));
    println!("{} intervals a robot", stated as f64 / ROBOTS as f64);
    assert!(
        stated >= 20 * ROBOTS as usize,
        "of 36 parameters, the base's rotation not counted, points determine 24 combinations: {stated} intervals"
    );
    100.0 * held as f64 / stated as f64
}

/// Number of runs that kept a part of the error model.
fn n_runs_with(
    runs: &[Run],
    part: impl Fn(&kincal::calibration::report::ErrorModel) -> f64,
) -> usize {
    runs.iter()
        .filter(|r| r.report.error_model.is_some_and(|e| part(&e) > 0.0))
        .count()
}

#[test]
fn with_white_noise_the_stated_intervals_hold_the_truth_in_93_to_97_of_100_cases() {
    let runs = &*PLAIN;
    let held = coverage(runs);
    println!("{held:.2} % held");
    assert!((93.0..=97.0).contains(&held), "{held} %");
    // A part that does not exist is kept in at most one of twenty cases: 80 · 0.05 plus three standard deviations.
    assert!(
        n_runs_with(runs, |e| e.misfit_std_deg) <= 10
            && n_runs_with(runs, |e| e.configuration_std_mm) == 0
    );
    let noise = runs
        .iter()
        .map(|r| r.report.error_model.unwrap().noise_std_mm)
        .sum::<f64>()
        / ROBOTS as f64;
    assert!(
        (noise / 0.03 - 1.0).abs() < 0.02,
        "the noise of 0.03 mm is found: {noise}"
    );
}

/// Tolerance for 80 robots at 95 % whose parameters err together (27 parameters each): three standard deviations of a share over
/// 80 · 27 independent intervals are 1.4 %.
const TOOL_HELD: std::ops::RangeInclusive<f64> = 93.0..=97.0;

#[test]
fn with_white_noise_the_stated_intervals_of_the_tool_hold_it_in_93_to_97_of_100_cases() {
    let (mut stated, mut held) = (0, 0);
    for (seed, Run { truth, report }) in PLAIN.iter().enumerate() {
        let elsewhere = poses(20, &mut Normal::new(1000 + seed as u64));
        let counts = tool_intervals_held(&paper_robot(), truth, report, &elsewhere, 0.0);
        (stated, held) = (stated + counts.0, held + counts.1);
    }
    let share = 100.0 * held as f64 / stated as f64;
    println!("{share:.2} % of {stated}");
    assert!(
        stated == 60 * ROBOTS as usize && TOOL_HELD.contains(&share),
        "{share} %"
    );
}

#[test]
fn what_the_points_of_a_configuration_share_is_found_and_counted() {
    let shared = Campaign {
        n_configurations: 20,
        n_targets: 3,
        shared_mm: 0.06,
        ..Campaign::PLAIN
    };
    let runs = runs_of_links(shared);
    assert!(
        n_runs_with(&runs, |e| e.configuration_std_mm) >= 76,
        "twice the noise is found in 95 % of the campaigns"
    );
    let held = coverage(&runs);
    println!("{held:.2} % held");
    assert!((93.0..=97.0).contains(&held), "{held} %");
}

#[test]
fn sag_that_no_model_knows_is_noticed_and_widens_the_intervals() {
    let runs = runs_of_links(Campaign {
        sag_rad: 5e-4,
        ..Campaign::PLAIN
    });
    assert_eq!(n_runs_with(&runs, |e| e.misfit_std_deg), ROBOTS as usize);
    let held = coverage(&runs);
    println!("{held:.2} % held");
    // What the posterior says of the links' error counts as one standard deviation, though it is known: intervals are rather too wide.
    assert!((92.0..99.0).contains(&held), "{held} %");
}

/// Tolerance of the predicted standard deviation over the true error, both over the same workspace: three times the 4 % of 80 robots; and the
/// mean over the workspace is a little below the root mean square.
const PREDICTED_OVER_TRUE: std::ops::Range<f64> = 0.85..1.13;
/// The same with sag: the prediction uses one number that is estimated from the residuals of each robot, and gravity may have any direction.
const PREDICTED_OVER_TRUE_WITH_SAG: std::ops::Range<f64> = 0.85..1.8;

#[test]
fn the_predicted_tool_uncertainty_is_that_of_unseen_poses() {
    for sag_rad in [0.0, 1e-4] {
        let sagging = || Campaign {
            sag_rad,
            ..Campaign::PLAIN
        };
        let runs = if sag_rad > 0.0 {
            &runs(sagging())
        } else {
            &*PLAIN
        };
        let (mut predicted, mut missed) = (0.0, 0.0);
        for (seed, Run { truth, report }) in runs.iter().enumerate() {
            let tool = report.tool_uncertainty.unwrap();
            assert!(tool.max_mm >= tool.mean_mm);
            predicted += tool.mean_mm * tool.mean_mm;
            let found = found(report);
            let error = |q: &Vec<f64>| {
                (position_with_sag(truth, q, 0, sag_rad) - found.position(q, 0)).norm_squared()
            };
            missed += poses(20, &mut Normal::new(1000 + seed as u64))
                .iter()
                .map(error)
                .sum::<f64>()
                / 20.0;
        }
        let ratio = (predicted / missed).sqrt();
        println!("sag {sag_rad}: predicted over true {ratio:.3}");
        let limit = if sag_rad > 0.0 {
            PREDICTED_OVER_TRUE_WITH_SAG
        } else {
            PREDICTED_OVER_TRUE
        };
        assert!(limit.contains(&ratio), "{ratio}");
    }
}

/// What was stated of the links counted for predictions with corrections too: three to 25 times their error.
#[test]
fn predictions_with_corrections_are_off_by_as_much_as_is_stated() {
    let none = NonlinearErrors::NONE;
    let sags = NonlinearErrors {
        sag_rad: 1e-3,
        ..none
    };
    let turns = NonlinearErrors {
        harmonic_rad: 3e-4,
        ..none
    };
    for errors in [sags, turns] {
        let mut ratios: Vec<f64> = (0..9)
            .map(|seed| {
                let nominal = limited(paper_robot());
                let found = identified(&nominal, &Campaign::PLAIN, &errors, seed, 200);
                let report = &found.report;
                let [links, corrected] =
                    [report.tool_uncertainty, report.corrected_tool_uncertainty];
                let [links_mm, corrected_mm] = [links, corrected].map(|tool| tool.unwrap().mean_mm);
                assert!(corrected_mm < 0.5 * links_mm, "{corrected_mm} {links_mm}");
                found.stated_mm.unwrap() / found.corrected_mm
            })
            .collect();
        ratios.sort_by(f64::total_cmp);
        println!("stated over true: {ratios:.2?}");
        assert!((0.67..1.5).contains(&ratios[4]), "{ratios:?}");
    }
}

#[test]
fn poses_that_show_little_of_the_robot_leave_the_tool_uncertain() {
    let nominal = paper_robot();
    let campaign = Campaign::PLAIN;
    let mut random = Normal::new(7);
    let truth = true_robot(&nominal, 1, &mut random);
    let good = poses(50, &mut random);
    let frozen_wrist: Vec<Vec<f64>> = good
        .iter()
        .map(|q| [&q[..3], &[0.3, -0.7, 0.2]].concat())
        .collect();
    let narrow: Vec<Vec<f64>> = good
        .iter()
        .map(|q| q.iter().map(|q| 0.3 + 0.1 * q).collect())
        .collect();
    let mut std_mm = |poses: &[Vec<f64>]| {
        let set = measure(&truth, poses, &campaign, &mut random);
        let request = CalibrationRequest {
            method: Method::LeastSquares,
            ..CalibrationRequest::new(nominal.clone(), set)
        };
        let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
        if report.tool_uncertainty.is_none() {
            // The nominal robot is nearer than the uncertainty that these poses leave.
            assert_nothing_is_stated(&report, "do not determine the robot");
        }
        let tool = report.tool_uncertainty;
        tool.map_or(f64::INFINITY, |tool| tool.mean_mm)
    };
    let (wide, frozen, narrow) = (std_mm(&good), std_mm(&frozen_wrist), std_mm(&narrow));
    println!("wide {wide:.4} mm, frozen wrist {frozen:.4} mm, narrow cloud {narrow:.4} mm");
    assert!(wide < 0.05 && frozen > 10.0 * wide && narrow > 10.0 * wide);
}

#[test]
fn a_file_that_stands_twice_in_the_upload_says_no_more_than_once() {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(5);
    let truth = true_robot(&nominal, 1, &mut random);
    let once = measure(
        &truth,
        &poses(30, &mut random),
        &Campaign::PLAIN,
        &mut random,
    );
    let mut twice = once.clone();
    twice.points.extend(once.points.iter().cloned());
    let stds = |set| {
        let report = calibrate(&CalibrationRequest::new(nominal.clone(), set), &mut |_| {
            ControlFlow::Continue(())
        })
        .unwrap();
        assert!(report.error_model.unwrap().misfit_std_deg == 0.0);
        report
            .parameters
            .iter()
            .map(|p| p.std_uncertainty.unwrap_or(0.0))
            .collect::<Vec<f64>>()
    };
    for (one, two) in stds(once).into_iter().zip(stds(twice)) {
        // The fit counts both rows, so its priors pull less; what is said of it counts each row once. As independent rows: 0.71 of it.
        assert!((one - two).abs() <= 1e-2 * one, "{one} {two}");
    }
}

/// Asserts that neither the tool nor any parameter has an uncertainty, and that the report gives this reason.
fn assert_nothing_is_stated(report: &CalibrationReport, why: &str) {
    let reason = report.uncertainty_absent_because.as_deref().unwrap_or("");
    assert!(reason.contains(why), "{reason:?}");
    assert!(report.tool_uncertainty.is_none() && report.uncertainty.is_none());
    assert!(report.error_model.is_none());
    let nothing = |p: &kincal::calibration::report::ParameterOutcome| {
        p.std_uncertainty.is_none() && p.interval_95.is_none()
    };
    assert!(report.parameters.iter().all(nothing));
}

#[test]
fn of_an_answer_that_did_not_converge_no_uncertainty_is_stated() {
    let mut request = CalibrationRequest {
        preset: Preset::Paper,
        method: Method::Pso,
        ..CalibrationRequest::new(paper_robot(), paper_set("first_noisy.csv"))
    };
    request.options.n_iterations = Some(200);
    let run = |request: &CalibrationRequest| {
        calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
    };
    let swarm = run(&request);
    println!(
        "verify {:.4} mm: {:?}",
        swarm.verify.unwrap().after.rms_mm,
        swarm.uncertainty_absent_because
    );
    assert_nothing_is_stated(&swarm, "did not converge");
    // A swarm of ours that is near the minimum, but not there: the weakest combinations are the furthest from it.
    let mut unrefined = CalibrationRequest {
        preset: Preset::Default,
        refine: Some(false),
        ..request.clone()
    };
    unrefined.options.n_particles = Some(60);
    assert_nothing_is_stated(&run(&unrefined), "did not converge");
    // Least squares that are told to stop at a large cost end at their start, though not for want of iterations.
    let mut stopped = request.clone();
    stopped.method = Method::LeastSquares;
    stopped.options.stop_at_cost_mm2 = Some(1e4);
    let stopped = run(&stopped);
    assert_eq!(stopped.termination, "cost_reached");
    assert_nothing_is_stated(&stopped, "standard deviations away from the minimum");
    // Least squares from there ends at the minimum.
    request.refine = Some(true);
    let refined = run(&request);
    let tool_mm = refined.tool_uncertainty.unwrap().mean_mm;
    assert!(refined.uncertainty_absent_because.is_none());
    let ratio = tool_mm / refined.verify.unwrap().after.rms_mm;
    assert!((0.2..5.0).contains(&ratio), "{tool_mm} mm");
}

/// Poses whose flange has one orientation within `turn_rad` about each axis, as a reflector faces its tracker.
fn facing(n: usize, turn_rad: f64, random: &mut Normal) -> Vec<Vec<f64>> {
    let links = paper_robot().links;
    let rotation = |q: &[f64]| t_base_flange(&links, q).rotation;
    let middle = [0.0, -0.4, 0.3, 0.0, 0.9, 0.0];
    let straight = rotation(&middle);
    let mut all = Vec::new();
    while all.len() < n {
        let mut uniform = || 2.0 * random.0.random::<f64>() - 1.0;
        let mut q = middle.to_vec();
        for (joint, half_width) in [0.6, 0.65, 0.8].into_iter().enumerate() {
            q[joint] += half_width * uniform();
        }
        let turn = Vector3::new(uniform(), uniform(), uniform()) * turn_rad;
        let wanted = Rotation3::new(turn) * straight;
        // Newton's method for the three joints of the wrist
        for _ in 0..30 {
            let here = rotation(&q);
            let mut by_joint = Matrix3::zeros();
            for joint in 0..3 {
                let mut moved = q.clone();
                moved[3 + joint] += 1e-6;
                let turned = (rotation(&moved) * here.inverse()).scaled_axis() / 1e-6;
                by_joint.set_column(joint, &turned);
            }
            let missing = (wanted * here.inverse()).scaled_axis();
            let Some(step) = by_joint.lu().solve(&missing) else {
                break;
            };
            (0..3).for_each(|joint| q[3 + joint] += step[joint].clamp(-0.5, 0.5));
        }
        let is_there = (wanted * rotation(&q).inverse()).scaled_axis().norm() < 1e-6;
        if is_there && q.iter().all(|q| q.abs() < 3.1) && q[4].abs() > 0.2 {
            all.push(q);
        }
    }
    all
}

/// An error that is no joint rotation: a smooth displacement field of 0.2 mm over the room, as from a linkage or from the air in front of the instrument.
struct Field(Vec<(Vector3<f64>, Vector3<f64>, f64)>);

impl Field {
    fn new(random: &mut Normal) -> Self {
        let wave = |random: &mut Normal| {
            let (by_mm, along_mm) = (random.vector() / 1000.0, random.vector() * 0.15);
            (by_mm, along_mm, random.draw() * 3.0)
        };
        Self((0..8).map(|_| wave(random)).collect())
    }

    fn at(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let wave = |(by_mm, along_mm, phase): &(Vector3<f64>, Vector3<f64>, f64)| {
            along_mm * (by_mm.dot(p) + phase).sin()
        };
        self.0.iter().map(wave).sum()
    }
}

#[test]
fn an_error_that_no_joint_makes_is_counted_over_the_workspace_however_little_of_it_was_measured() {
    for seed in 0..4 {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, 1, &mut random);
        let field = Field::new(&mut random);
        let measured = facing(400, 0.3, &mut random);
        let mut set = measure(&truth, &measured, &Campaign::PLAIN, &mut random);
        for point in &mut set.points {
            point.position_mm += field.at(&point.position_mm);
        }
        let request = CalibrationRequest {
            method: Method::LeastSquares,
            corrections: Some(CorrectionsChoice::Off),
            ..CalibrationRequest::new(nominal, set)
        };
        let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
        let found = found(&report);
        let unseen = poses(200, &mut random);
        let missed = |q: &Vec<f64>| {
            let there = truth.position(q, 0);
            (there + field.at(&there) - found.position(q, 0)).norm_squared()
        };
        let missed_mm = (unseen.iter().map(missed).sum::<f64>() / 200.0).sqrt();
        println!(
            "seed {seed}: {missed_mm:.3} mm off over the workspace; {:?}, {:?}",
            report.tool_uncertainty, report.uncertainty_absent_because
        );
        match report.tool_uncertainty {
            Some(tool) => assert!(missed_mm < 1.5 * tool.mean_mm, "{missed_mm} mm, {tool:?}"),
            None => assert_nothing_is_stated(&report, "do not determine the robot"),
        }
    }
}

#[test]
fn of_measured_robots_only_an_uncertainty_that_the_points_determine_is_stated() {
    let Some(root) = real_data() else { return };
    let of = |folder: &str, file: &str| {
        let bytes = std::fs::read(root.join(folder).join(file)).unwrap();
        let mut set: MeasurementSet = own_form::parse(&bytes, Frame::Instrument, 6).unwrap();
        set.points
            .iter_mut()
            .for_each(|point| point.subset = Some(Subset::Identify));
        let request = CalibrationRequest {
            corrections: Some(CorrectionsChoice::Off),
            ..CalibrationRequest::new(robot(&root.join(folder).join("robot.json")), set)
        };
        calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap()
    };
    // Before, 0.4 m were stated for a robot that is known to 0.3 mm.
    for visit in ["visit_1.csv", "visit_2.csv"] {
        let report = of("motoman_ma1400", visit);
        assert_nothing_is_stated(&report, "do not determine the robot");
    }
    let sags = of("qkm_hl6", "set.csv");
    let tool_mm = sags.tool_uncertainty.unwrap().mean_mm;
    assert!(sags.uncertainty_absent_because.is_none() && (0.1..1.0).contains(&tool_mm));
}

/// The tool's true rms error over the workspace, and the stated one, mm.
fn true_and_stated_mm(
    truth: &KinematicModel,
    report: &CalibrationReport,
    bent: impl Fn(&[f64]) -> Vec<f64>,
    random: &mut Normal,
) -> (f64, Option<f64>) {
    let found = found(report);
    let missed = |q: &Vec<f64>| {
        let there = truth.position(&bent(q), 0);
        (there - found.position(q, 0)).norm_squared()
    };
    let squares: f64 = poses(200, random).iter().map(missed).sum();
    let stated = report.tool_uncertainty.map(|tool| tool.mean_mm);
    assert_eq!(
        stated.is_none(),
        report.uncertainty_absent_because.is_some()
    );
    ((squares / 200.0).sqrt(), stated)
}

#[test]
fn what_the_papers_model_holds_is_counted_or_nothing_is_stated() {
    let nominal = paper_robot();
    let (mut n_stated, mut n) = (0, 0);
    // Joints with a harmonic; a reflector on an axis, with joint zeros that are off by 2°.
    for (amplitude_rad, off_deg, n_poses) in [(1e-4, 0.0, 800), (0.0, 2.0, 25), (0.0, 2.0, 60)] {
        for seed in 0..4 {
            let mut random = Normal::new(seed);
            let mut truth = true_robot(&nominal, 1, &mut random);
            truth.t_instrument_base = nalgebra::IsometryMatrix3::identity();
            truth.targets_mm[0] = Vector3::new(0.0, 0.0, 110.0);
            for link in &mut truth.links {
                link.theta_offset_rad += f64::to_radians(off_deg) * random.draw();
            }
            let phases: Vec<f64> = (0..6).map(|_| 3.0 * random.draw()).collect();
            let bent = |q: &[f64]| -> Vec<f64> {
                let bend = |(q, phase): (&f64, &f64)| q + amplitude_rad * (q + phase).sin();
                q.iter().zip(&phases).map(bend).collect()
            };
            let measured = poses(n_poses, &mut random);
            let mut set = measure(&truth, &measured, &Campaign::PLAIN, &mut random);
            set.frame = Frame::Base;
            for (point, q) in set.points.iter_mut().zip(&measured) {
                point.position_mm += truth.position(&bent(q), 0) - truth.position(q, 0);
            }
            let request = CalibrationRequest {
                corrections: Some(CorrectionsChoice::Off),
                ..CalibrationRequest::new(nominal.clone(), set)
            };
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let (true_mm, stated_mm) = true_and_stated_mm(&truth, &report, bent, &mut random);
            println!("{n_poses} poses, seed {seed}: {true_mm:.3} mm, stated {stated_mm:?}");
            assert!(
                stated_mm.is_none_or(|stated_mm| true_mm < 2.0 * stated_mm),
                "{n_poses} poses, seed {seed}: {true_mm} mm, stated {stated_mm:?}"
            );
            n_stated += usize::from(stated_mm.is_some());
            n += 1;
        }
    }
    println!("stated for {n_stated} of {n}");
}

/// Harmonics that corrections find are no noise: the links alone are off by them everywhere. An arm with parallel axes.
#[test]
fn what_corrections_find_beyond_the_links_is_counted_in_what_is_stated_of_the_links() {
    let Some(root) = real_data() else { return };
    let nominal = robot(&root.join("ur10_tmac/robot.json"));
    for amplitude_rad in [2e-4, 4e-4] {
        for seed in 0..3 {
            let mut random = Normal::new(seed);
            let truth = true_robot(&nominal, 1, &mut random);
            let bent = |q: &[f64]| -> Vec<f64> {
                q.iter()
                    .map(|q| q + amplitude_rad * (2.0 * q).sin())
                    .collect()
            };
            let measured = poses(200, &mut random);
            let mut set = measure(&truth, &measured, &Campaign::PLAIN, &mut random);
            for (point, q) in set.points.iter_mut().zip(&measured) {
                point.position_mm += truth.position(&bent(q), 0) - truth.position(q, 0);
            }
            let request = CalibrationRequest::new(nominal.clone(), set);
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let (true_mm, stated_mm) = true_and_stated_mm(&truth, &report, bent, &mut random);
            println!("{amplitude_rad}, seed {seed}: {true_mm:.3} mm, stated {stated_mm:?}");
            assert!(
                stated_mm.is_none_or(|stated_mm| true_mm < 1.5 * stated_mm),
                "{amplitude_rad}, seed {seed}: {true_mm} mm, stated {stated_mm:?}"
            );
        }
    }
}

/// Gears of a wrist that are not compensated, and joints whose errors go round several times in a turn.
#[test]
fn joints_that_follow_each_other_and_harmonics_of_some_orders_are_counted() {
    let none = NonlinearErrors::NONE;
    let errors = [
        NonlinearErrors {
            follows: 0.005,
            ..none
        },
        NonlinearErrors {
            follows: 0.02,
            ..none
        },
        NonlinearErrors {
            harmonic_rad: 3e-4,
            order: 2.0,
            ..none
        },
        NonlinearErrors {
            harmonic_rad: 3e-4,
            order: 3.0,
            ..none
        },
    ];
    for bent in errors {
        let ratio = |seed| {
            let found = identified(&limited(paper_robot()), &Campaign::PLAIN, &bent, seed, 200);
            found
                .report
                .tool_uncertainty
                .map_or(f64::NAN, |tool| tool.mean_mm)
                / found.links_mm
        };
        let mut ratios: Vec<f64> = (0..9).map(ratio).collect();
        ratios.sort_by(f64::total_cmp);
        println!("{bent:?}: stated over true {ratios:.2?}");
        assert!(
            (0.67..1.5).contains(&ratios[4]) && ratios[0] > 0.5,
            "{bent:?}: {ratios:.2?}"
        );
    }
}

#[test]
fn a_joint_that_follows_another_one_is_named_and_no_other_misfit_is_taken_for_it() {
    let none = NonlinearErrors::NONE;
    let follows = |follows| NonlinearErrors { follows, ..none };
    let sags = NonlinearErrors {
        sag_rad: 1e-3,
        ..none
    };
    let bent = NonlinearErrors {
        sag_rad: 1e-3,
        harmonic_rad: 3e-4,
        ..none
    };
    let hardens = NonlinearErrors {
        hardening_rad: 1e-3,
        ..none
    };
    for (errors, share, n_configurations) in [
        (follows(0.005), Some(0.005), 25),
        (follows(0.005), Some(0.005), 50),
        (follows(-0.02), Some(-0.02), 50),
        (none, None, 50),
        (sags, None, 50),
        (bent, None, 50),
        (hardens, None, 50),
        (hardens, None, 200),
    ] {
        let campaign = Campaign {
            n_configurations,
            ..Campaign::PLAIN
        };
        for seed in 0..8 {
            let found = identified(&limited(paper_robot()), &campaign, &errors, seed, 10);
            let mut warnings = found.report.warnings.iter();
            let told = warnings.find(|w| w.code == "joint_follows");
            println!("{errors:?}, seed {seed}: {told:?}");
            assert_eq!(told.is_some(), share.is_some(), "{errors:?}, seed {seed}");
            let (Some(told), Some(share)) = (told, share) else {
                continue;
            };
            let detail = &told.detail;
            assert!(detail.starts_with("joint 6 turns by"), "{detail}");
            let stated = detail
                .split("add ")
                .nth(1)
                .and_then(|rest| rest.split(' ').next());
            let stated: f64 = stated.unwrap().parse().unwrap();
            assert!((stated - share).abs() < 0.1 * share.abs(), "{detail}");
        }
    }
}

#[test]
fn no_uncertainty_is_stated_that_is_larger_than_the_nominal_robots_error() {
    let Some(root) = real_data() else { return };
    for (folder, file) in [
        ("motoman_ma1400", "visit_1.csv"),
        ("motoman_ma1400", "visit_2.csv"),
        ("ur10_tmac", "data_D.csv"),
    ] {
        let text = std::fs::read_to_string(root.join(folder).join(file)).unwrap();
        // Measured poses have columns for the rotation, which kincal does not read yet.
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let is_read = |name: &str| {
            name == "configuration"
                || name.starts_with('q')
                || ["x_mm", "y_mm", "z_mm"].contains(&name)
        };
        let of_line = |line: &str| {
            let cells = line.split(',').zip(&names);
            let remaining: Vec<&str> = cells
                .filter(|(_, name)| is_read(name))
                .map(|(cell, _)| cell)
                .collect();
            remaining.join(",") + "\n"
        };
        let read: String = text.lines().map(of_line).collect();
        let set: MeasurementSet = own_form::parse(read.as_bytes(), Frame::Instrument, 6).unwrap();
        for seed in 0..4 {
            let request = CalibrationRequest {
                corrections: Some(CorrectionsChoice::Off),
                seed,
                ..CalibrationRequest::new(robot(&root.join(folder).join("robot.json")), set.clone())
            };
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let nominal_mm = report.identify.before.rms_mm;
            println!(
                "{file}, seed {seed}: nominal {nominal_mm:.3} mm, stated {:?}, {:?}",
                report.tool_uncertainty, report.uncertainty_absent_because
            );
            match report.tool_uncertainty {
                Some(tool) => assert!(tool.mean_mm <= nominal_mm, "{file}, seed {seed}: {tool:?}"),
                None => assert_nothing_is_stated(&report, "determine"),
            }
        }
    }
}
