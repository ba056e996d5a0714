//! What has changed since a robot's last session: false alarms, detection, and the names.

#[path = "support/data.rs"]
mod data;
#[path = "support/simulation.rs"]
mod simulation;

use data::{paper_robot, paper_set};
use kincal::calibration::changes::{Changes, Kind};
use kincal::calibration::request::PreviousSession;
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::MeasurementSet;
use std::ops::ControlFlow;

fn two_sessions(seed: u64, change: impl Fn(&mut KinematicModel)) -> (MeasurementSet, MeasurementSet) {
    simulation::two_sessions(&paper_robot(), seed, change)
}

/// What is said of `after` when the robot was last identified from `before`.
fn compared(robot: &Robot, before: &MeasurementSet, after: &MeasurementSet) -> Changes {
    let previous = Some(PreviousSession { set: before.clone(), frames: None });
    let request = CalibrationRequest { method: Method::LeastSquares, previous, ..CalibrationRequest::new(robot.clone(), after.clone()) };
    calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap().changes.unwrap()
}

fn names(changes: &Changes) -> Vec<&str> {
    changes.all.iter().map(|c| c.name.as_str()).collect()
}

fn of_the_robot<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let mut names: Vec<&str> = names.iter().copied().filter(|n| !n.starts_with("base") && !n.starts_with("target")).collect();
    names.sort_unstable();
    names
}

/// Pairs of sessions; `examples/changes_study.rs` takes 1,000.
const PAIRS: u64 = 40;

#[test]
fn a_robot_that_has_not_changed_is_called_changed_in_one_of_a_hundred_cases_wherever_its_base_and_targets_stand() {
    let mut alarms = 0;
    for seed in 0..PAIRS {
        let (first, second) = two_sessions(seed, |_| ());
        let changes = compared(&paper_robot(), &first, &second);
        alarms += usize::from(changes.kind.is_some());
        assert!(changes.warnings.iter().any(|w| w.code == "placement_changed"), "the tracker stands elsewhere");
        assert!(names(&changes).iter().filter(|n| n.starts_with("base")).count() >= 4);
    }
    // 40 cases at 1 %: four or more in 7 of 10,000
    assert!(alarms <= 3, "{alarms} of {PAIRS}");
}

#[test]
fn a_collision_is_found_and_the_parameters_that_jumped_are_named() {
    for seed in 100..110 {
        let (first, second) = two_sessions(seed, |robot| {
            robot.links[2].theta_offset_rad += 0.1f64.to_radians();
            robot.links[3].a_mm -= 0.3;
        });
        let changes = compared(&paper_robot(), &first, &second);
        assert_eq!(changes.kind, Some(Kind::Collision));
        let warning = &changes.warnings[0];
        assert!(warning.code == "robot_changed" && warning.detail.contains("collision"), "{}", warning.detail);
        let first_two: Vec<&str> = names(&changes)[..2].to_vec();
        assert_eq!(of_the_robot(&first_two), ["a_4", "theta_offset_3"]);
        let turned = changes.all.iter().find(|c| c.name == "theta_offset_3").unwrap();
        // within four of its own standard deviations
        assert!((turned.delta - 0.1).abs() < 4.0 * 0.1 / turned.sigmas, "{turned:?}");
    }
}

#[test]
fn what_happened_to_the_papers_robot_between_its_sessions_is_told_apart() {
    let against_first = |name: &str| compared(&paper_robot(), &paper_set("first.csv"), &paper_set(name));
    let unchanged = against_first("followup_unchanged.csv");
    assert_eq!((unchanged.kind, unchanged.all.len(), unchanged.warnings.len()), (None, 0, 0));
    let drifted = against_first("followup_drifted.csv");
    assert_eq!(drifted.kind, Some(Kind::Drift));
    let collision = against_first("followup_collision.csv");
    assert_eq!(collision.kind, Some(Kind::Collision));
    assert_eq!(of_the_robot(&names(&collision)[..3]), ["a_3", "theta_offset_2", "theta_offset_3"]);
    for (name, planted) in [("theta_offset_2", 0.2), ("theta_offset_3", -0.15), ("a_3", 0.1)] {
        let found = collision.all.iter().find(|c| c.name == name).unwrap().delta;
        // what two linearisations 1 mm and 0.2° apart differ by
        assert!((found - planted).abs() < 2e-3, "{name}: {found}");
    }
}

#[test]
fn the_same_points_again_have_not_changed() {
    let (first, _) = two_sessions(7, |_| ());
    let changes = compared(&paper_robot(), &first, &first);
    assert_eq!((changes.kind, changes.all.len(), changes.warnings.len()), (None, 0, 0));
}
