//! Partial recalibration: named parameters are identified, the others are held, and the stated intervals include the uncertainty of both.

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::partial::{Held, calibrate_partially};
use kincal::calibration::request::{CorrectionsChoice, ParameterChoice, PreviousSession};
use kincal::calibration::{CalibrationRequest, calibrate};
use std::ops::ControlFlow;

/// 95 % intervals of theta_offset_3 over simulated collisions: how many contained the truth, as stated and with the held parameters taken as exact.
fn held(n: u64) -> (usize, usize) {
    let nominal = limited(paper_robot());
    let campaign = |n_configurations| Campaign {
        n_configurations,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let mut counts = (0, 0);
    for seed in 0..n {
        let mut random = Normal::new(1_000 + seed);
        let mut truth = true_robot(&nominal, 1, &mut random);
        let first_poses = poses(18, &mut random);
        let first = measure(&truth, &first_poses, &campaign(18), &mut random);
        let whole = CalibrationRequest {
            corrections: Some(CorrectionsChoice::Off),
            ..CalibrationRequest::new(nominal.clone(), first.clone())
        };
        let before = calibrate(&whole, &mut |_| ControlFlow::Continue(())).unwrap();
        truth.links[2].theta_offset_rad += 0.1f64.to_radians();
        let new_poses = poses(30, &mut random);
        let second = measure(&truth, &new_poses, &campaign(30), &mut random);
        let request = CalibrationRequest {
            parameters: ParameterChoice::Identify(vec!["theta_offset_3".into()]),
            corrections: Some(CorrectionsChoice::Off),
            ..CalibrationRequest::new(nominal.clone(), second)
        };
        let held = Held {
            links: before.links.clone(),
            session: PreviousSession {
                set: first,
                frames: None,
                estimate: None,
            },
        };
        let report =
            calibrate_partially(&request, &held, &mut |_| ControlFlow::Continue(())).unwrap();
        for (i, (found, earlier)) in report.links.iter().zip(&before.links).enumerate() {
            let same = (found.a_mm, found.alpha_rad, found.d_mm, found.beta_rad)
                == (
                    earlier.a_mm,
                    earlier.alpha_rad,
                    earlier.d_mm,
                    earlier.beta_rad,
                );
            assert!(
                same && (i == 2 || found.theta_offset_rad == earlier.theta_offset_rad),
                "link {i} was to stay"
            );
        }
        let outcome = report
            .parameters
            .iter()
            .find(|p| p.name == "theta_offset_3")
            .unwrap();
        assert_eq!(outcome.nominal, 0.0);
        let meant = truth.links[2].theta_offset_rad.to_degrees();
        let [low, high] = outcome
            .interval_95
            .unwrap_or_else(|| panic!("seed {seed}: {:?}", report.uncertainty_absent_because));
        counts.0 += usize::from((low..=high).contains(&meant));
        // The same fit with the held parameters taken as exact: the narrower interval.
        let exact = CalibrationRequest {
            robot: kincal::kinematics::Robot {
                links: before.links,
                ..nominal.clone()
            },
            ..request
        };
        let narrow = calibrate(&exact, &mut |_| ControlFlow::Continue(())).unwrap();
        let [low, high] = narrow
            .parameters
            .iter()
            .find(|p| p.name == "theta_offset_3")
            .unwrap()
            .interval_95
            .unwrap();
        counts.1 += usize::from((low..=high).contains(&meant));
        assert!(
            report.tool_uncertainty.unwrap().mean_mm > narrow.tool_uncertainty.unwrap().mean_mm
        );
    }
    counts
}

#[test]
fn stated_intervals_hold_the_truth_as_often_as_they_say() {
    let n = 30;
    let (stated, exact) = held(n);
    println!("of {n} intervals {stated} held the truth; with what was held as exact {exact}");
    // A true 95 % interval would contain the truth in 25 or fewer of 30 runs once in sixty times.
    assert!(stated >= 26, "{stated}");
    assert!(exact < stated, "{exact} {stated}");
}

/// Joint 5 moved by 0.3°, and somebody identifies another joint: what is stated of that joint would not be true.
#[test]
fn a_partial_recalibration_of_the_wrong_joint_states_no_uncertainty() {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(77);
    let mut truth = true_robot(&nominal, 1, &mut random);
    let campaign = |n_configurations| Campaign {
        n_configurations,
        noise_mm: 0.05,
        ..Campaign::PLAIN
    };
    let first = measure(&truth, &poses(40, &mut random), &campaign(40), &mut random);
    let whole = CalibrationRequest {
        corrections: Some(CorrectionsChoice::Off),
        ..CalibrationRequest::new(nominal.clone(), first.clone())
    };
    let before = calibrate(&whole, &mut |_| ControlFlow::Continue(())).unwrap();
    truth.links[4].theta_offset_rad += 0.3f64.to_radians();
    // with 30 configurations all parameters can be identified from the new session; with 7 the earlier session is the measure
    for n_configurations in [30, 7] {
        let poses = poses(n_configurations, &mut random);
        let second = measure(&truth, &poses, &campaign(n_configurations), &mut random);
        for named in 1..=6 {
            let name = format!("theta_offset_{named}");
            let request = CalibrationRequest {
                parameters: ParameterChoice::Identify(vec![name.clone()]),
                ..CalibrationRequest::new(nominal.clone(), second.clone())
            };
            let held = Held {
                links: before.links.clone(),
                session: PreviousSession {
                    set: first.clone(),
                    frames: None,
                    estimate: None,
                },
            };
            let report =
                calibrate_partially(&request, &held, &mut |_| ControlFlow::Continue(())).unwrap();
            let told: Vec<&str> = report
                .warnings
                .iter()
                .filter(|warning| warning.code == "other_parameters_changed")
                .map(|warning| warning.detail.as_str())
                .collect();
            println!("{n_configurations} configurations, {name}: {told:?}");
            let is_right = named == 5;
            assert_eq!(told.is_empty(), is_right, "{name}: {told:?}");
            assert_eq!(report.uncertainty.is_some(), is_right, "{name}");
            assert_eq!(report.tool_uncertainty.is_some(), is_right, "{name}");
            if n_configurations == 30 && !is_right {
                assert!(told[0].contains("theta_offset_5 by 0.3"), "{told:?}");
            }
        }
    }
}
