//! What the report says of its own errors, held against robots whose truth is known.

#[path = "support/data.rs"]
mod data;
#[path = "support/simulation.rs"]
mod simulation;

use data::paper_robot;
use kincal::calibration::request::Loss;
use kincal::calibration::{CalibrationReport, CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use simulation::{
    Campaign, Normal, found, intervals_held, limited, measure, poses, position_with_sag,
    tool_intervals_held, true_robot,
};
use std::ops::ControlFlow;

/// Robots per test; `examples/coverage_study.rs` takes 1,000.
const ROBOTS: u64 = 80;

struct Run {
    truth: KinematicModel,
    report: CalibrationReport,
}

fn runs(campaign: Campaign) -> Vec<Run> {
    let run = |seed: u64| {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, campaign.n_targets, &mut random);
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
        Run {
            truth,
            report: calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap(),
        }
    };
    (0..ROBOTS).map(run).collect()
}

/// The same, two of the points of each robot 5 mm off, and a loss that bounds what they do.
fn robust_runs(loss: Loss) -> Vec<Run> {
    let run = |seed: u64| {
        let nominal = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = true_robot(&nominal, 1, &mut random);
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
    let plain = mean_std(&runs(Campaign::PLAIN));
    for loss in [Loss::Huber, Loss::Tukey] {
        let runs = robust_runs(loss);
        let (held, wider) = (coverage(&runs), mean_std(&runs) / plain);
        println!("{loss:?}: {held:.2} % held, {wider:.3} times as wide as without wild points");
        // 95 % of the efficiency is 1.026 times the width; two of 50 points pull with Huber's bound
        assert!(
            (92.0..=97.0).contains(&held) && (0.95..1.3).contains(&wider),
            "{loss:?}: {held} %, {wider}"
        );
    }
}

/// Share of the stated 95 % intervals that hold the truth, %.
fn coverage(runs: &[Run]) -> f64 {
    let counts = runs
        .iter()
        .map(|r| intervals_held(&paper_robot(), &r.truth, &r.report));
    let (stated, held) = counts.fold((0, 0), |(s, h), (stated, held)| (s + stated, h + held));
    assert!(
        stated >= 24 * ROBOTS as usize,
        "every parameter but the base's rotation has an interval"
    );
    100.0 * held as f64 / stated as f64
}

/// How many runs kept a part of the error model.
fn kept(runs: &[Run], part: impl Fn(&kincal::calibration::report::ErrorModel) -> f64) -> usize {
    runs.iter()
        .filter(|r| r.report.error_model.is_some_and(|e| part(&e) > 0.0))
        .count()
}

#[test]
fn with_white_noise_the_stated_intervals_hold_the_truth_in_93_to_97_of_100_cases() {
    let runs = runs(Campaign::PLAIN);
    let held = coverage(&runs);
    println!("{held:.2} % held");
    assert!((93.0..=97.0).contains(&held), "{held} %");
    // a part that is not there is kept in at most one of twenty cases; 80 · 0.05 and three standard deviations of that
    assert!(
        kept(&runs, |e| e.misfit_std_rad) <= 10 && kept(&runs, |e| e.configuration_std_mm) == 0
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

/// Of 80 robots at 95 %, with the poses of one robot erring together (27 parameters): three standard deviations of a share over
/// 80 · 27 independent intervals are 1.4 %.
const TOOL_HELD: std::ops::RangeInclusive<f64> = 93.0..=97.0;

#[test]
fn with_white_noise_the_stated_intervals_of_the_tool_hold_it_in_93_to_97_of_100_cases() {
    let (mut stated, mut held) = (0, 0);
    for (seed, Run { truth, report }) in runs(Campaign::PLAIN).iter().enumerate() {
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
    let runs = runs(shared);
    assert!(
        kept(&runs, |e| e.configuration_std_mm) >= 76,
        "twice the noise is found in 95 % of the campaigns"
    );
    let held = coverage(&runs);
    println!("{held:.2} % held");
    assert!((93.0..=97.0).contains(&held), "{held} %");
}

#[test]
fn sag_that_no_model_knows_is_noticed_and_widens_the_intervals() {
    let runs = runs(Campaign {
        sag_rad: 5e-4,
        ..Campaign::PLAIN
    });
    assert_eq!(kept(&runs, |e| e.misfit_std_rad), ROBOTS as usize);
    let held = coverage(&runs);
    println!("{held:.2} % held");
    // 86 % in the study: the links take up part of the sag, and what they take up cannot be seen in the residuals
    assert!((80.0..97.0).contains(&held), "{held} %");
}

/// The predicted standard deviation against the true error, both over the same workspace. 80 robots leave 4 %, of which three; and the
/// mean over the workspace is a little below the root mean square.
const PREDICTED_OVER_TRUE: std::ops::Range<f64> = 0.85..1.13;
/// With sag, what is predicted rests on an estimate of one number from the residuals of each robot, and gravity may come from anywhere.
const PREDICTED_OVER_TRUE_WITH_SAG: std::ops::Range<f64> = 0.85..1.8;

#[test]
fn the_predicted_tool_uncertainty_is_that_of_unseen_poses() {
    for sag_rad in [0.0, 1e-4] {
        let runs = runs(Campaign {
            sag_rad,
            ..Campaign::PLAIN
        });
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
        calibrate(&request, &mut |_| ControlFlow::Continue(()))
            .unwrap()
            .tool_uncertainty
            .unwrap()
            .mean_mm
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
        assert!(report.error_model.unwrap().misfit_std_rad == 0.0);
        report
            .parameters
            .iter()
            .map(|p| p.std_uncertainty.unwrap_or(0.0))
            .collect::<Vec<f64>>()
    };
    for (one, two) in stds(once).into_iter().zip(stds(twice)) {
        // what the data hardly see is settled by their number, twice as large
        assert!((one - two).abs() <= 1e-3 * one, "{one} {two}");
    }
}
