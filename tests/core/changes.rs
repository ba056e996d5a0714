//! Changes since a robot's last session: false alarms, detection, and names of the changed parameters.

use crate::data::{paper_robot, paper_set};
use crate::simulation::{Normal, links_alone, true_robot};
use kincal::calibration::report::{ChangeKind, Changes};
use kincal::calibration::request::{Estimate, Model, PreviousSession};
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::identification::KinematicModel;
use kincal::kinematics::{Link, Robot};
use kincal::measurement::{Frame, MeasurementSet, Point};
use kincal::wire::estimate::StoredEstimate;
use kincal::wire::json;
use kincal::wire::robot::RobotBody;
use nalgebra::Vector3;
use rand::RngExt;
use std::ops::ControlFlow;

const ROBOT_JSON: &str = include_str!("../../data/paper/robot.json");

fn two_sessions(
    seed: u64,
    change: impl Fn(&mut KinematicModel),
) -> (MeasurementSet, MeasurementSet) {
    crate::simulation::two_sessions(&paper_robot(), seed, change)
}

/// The reported changes of `after` for a robot that was last identified from `before`.
fn compared(robot: &Robot, before: &MeasurementSet, after: &MeasurementSet) -> Changes {
    compared_with(robot, before, kept_estimate(robot, before), after)
}

fn compared_with(
    robot: &Robot,
    before: &MeasurementSet,
    estimate: Option<Estimate>,
    after: &MeasurementSet,
) -> Changes {
    let previous = Some(PreviousSession {
        set: before.clone(),
        frames: None,
        estimate,
    });
    let request = CalibrationRequest {
        method: Method::LeastSquares,
        previous,
        ..CalibrationRequest::new(robot.clone(), after.clone())
    };
    let report = calibrate(&links_alone(&request), &mut |_| ControlFlow::Continue(())).unwrap();
    report.changes.unwrap()
}

/// What the service keeps of an identification; corrections are not compared.
fn kept_estimate(robot: &Robot, set: &MeasurementSet) -> Option<Estimate> {
    let request = CalibrationRequest::new(robot.clone(), set.clone());
    let report = calibrate(&links_alone(&request), &mut |_| ControlFlow::Continue(())).unwrap();
    report.estimate
}

/// Both fits end where their steps are below a thousandth of a standard deviation, so their distances agree to about as much.
const SAME_CHI_SQUARE: f64 = 0.01;

#[test]
fn a_kept_estimate_says_what_the_earlier_session_says_when_it_is_fitted_again() {
    let robot = paper_robot();
    for seed in 0..4 {
        let turned = |model: &mut KinematicModel| model.links[2].theta_offset_rad += 1e-3;
        let (first, second) = two_sessions(seed, turned);
        let kept = kept_estimate(&robot, &first);
        assert!(kept.is_some());
        let by_kept = compared_with(&robot, &first, kept, &second);
        let by_fit = compared_with(&robot, &first, None, &second);
        assert_eq!(names(&by_kept), names(&by_fit), "robot {seed}");
        let ratio = by_kept.chi_square / by_fit.chi_square;
        assert!(
            (ratio - 1.0).abs() < SAME_CHI_SQUARE,
            "robot {seed}: {ratio}"
        );
    }
}

#[test]
fn an_estimate_is_stored_to_the_last_bit() {
    let (first, _) = two_sessions(0, |_| ());
    let estimate = kept_estimate(&paper_robot(), &first).unwrap();
    let body: RobotBody = json::parse(ROBOT_JSON.as_bytes()).unwrap();
    let stored = StoredEstimate::new(&estimate, Model::Complete, &body).unwrap();
    let text = serde_json::to_string(&stored).unwrap();
    let read: StoredEstimate = serde_json::from_str(&text).unwrap();
    assert_eq!(Estimate::try_from(&read).unwrap(), estimate);
    // an estimate of an older version has no errors of corrections
    assert!(!text.contains("corrected") && estimate.corrected.is_none());
}

fn names(changes: &Changes) -> Vec<&str> {
    changes.all.iter().map(|c| c.name.as_str()).collect()
}

fn of_the_robot<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let mut names: Vec<&str> = names
        .iter()
        .copied()
        .filter(|n| !n.starts_with("base") && !n.starts_with("target"))
        .collect();
    names.sort_unstable();
    names
}

/// Pairs of sessions; `examples/study/changes.rs` takes 1,000.
const PAIRS: u64 = 40;

#[test]
fn a_robot_that_has_not_changed_is_called_changed_in_one_of_a_hundred_cases_wherever_its_base_and_targets_stand()
 {
    let mut alarms = 0;
    for seed in 0..PAIRS {
        let (first, second) = two_sessions(seed, |_| ());
        let changes = compared(&paper_robot(), &first, &second);
        alarms += usize::from(changes.kind.is_some());
        assert!(
            changes
                .warnings
                .iter()
                .any(|w| w.code == "placement_changed"),
            "the tracker stands elsewhere"
        );
        assert!(
            names(&changes)
                .iter()
                .filter(|n| n.starts_with("base"))
                .count()
                >= 4
        );
    }
    // 40 cases at 1 %: four or more in 7 of 10,000
    assert!(alarms <= 3, "{alarms} of {PAIRS}");
}

/// Three parallel axes, as of a SCARA robot without its spindle.
fn parallel_arm() -> Robot {
    let link = |a_mm: f64, alpha_deg: f64, d_mm: f64| Link {
        a_mm,
        alpha_rad: alpha_deg.to_radians(),
        d_mm,
        ..Link::default()
    };
    let mut robot = Robot::from_links(vec![
        link(0.0, 0.0, 300.0),
        link(325.0, 0.0, 0.0),
        link(275.0, 180.0, -50.0),
    ]);
    robot.joint_limits_rad = vec![Some((-2.2, 2.2)); 3];
    robot
}

/// Two sessions of it, 60 poses of one target each: the tracker stands elsewhere, and the second is of a changed robot.
fn of_the_parallel_arm(
    seed: u64,
    change: impl Fn(&mut KinematicModel),
) -> (MeasurementSet, MeasurementSet) {
    let mut random = Normal::new(seed);
    let first = true_robot(&parallel_arm(), 1, &mut random);
    let mut second = true_robot(&parallel_arm(), 1, &mut random);
    (second.links, second.targets_mm) = (first.links.clone(), first.targets_mm.clone());
    change(&mut second);
    let mut session = |truth: &KinematicModel| {
        let point = |configuration: usize| {
            let q_rad: Vec<f64> = (0..3)
                .map(|_| 2.2 * (2.0 * random.0.random::<f64>() - 1.0))
                .collect();
            let position_mm = truth.position(&q_rad, 0) + random.vector() * 0.04;
            let configuration_name = format!("c{configuration}");
            Point {
                q_rad,
                position_mm,
                configuration: configuration_name,
                ..Point::empty(3, configuration)
            }
        };
        MeasurementSet::new(Frame::Instrument, (0..60).map(point).collect())
    };
    (session(&first), session(&second))
}

#[test]
fn an_arm_whose_axes_are_all_parallel_has_not_changed_either_and_a_change_of_it_is_named() {
    let mut alarms = 0;
    for seed in 0..20 {
        let (first, second) = of_the_parallel_arm(seed, |_| ());
        let changes = compared(&parallel_arm(), &first, &second);
        alarms += usize::from(changes.kind.is_some());
        if changes.kind.is_some() {
            println!(
                "robot {seed}: {:.1} over {} combinations, {:?}",
                changes.chi_square, changes.n_combinations, changes.all
            );
        }
        // A combination that neither session determines has no size.
        assert!(
            changes
                .all
                .iter()
                .all(|c| c.delta.abs() < 1e4 && c.sigmas.is_finite()),
            "{:?}",
            changes.all
        );
    }
    // The target's position along the axes is assumed, and tilted axes carry its error into a_3: the covariance has only a part of it.
    assert!(alarms <= 2, "{alarms} of 20");
    for seed in 20..25 {
        let (first, second) = of_the_parallel_arm(seed, |robot| {
            robot.links[1].theta_offset_rad += 0.05f64.to_radians()
        });
        let changes = compared(&parallel_arm(), &first, &second);
        let first_named = &changes.all[0];
        assert!(
            first_named.name == "theta_offset_2" && (first_named.delta - 0.05).abs() < 0.02,
            "{:?}",
            changes.all
        );
    }
}

#[test]
fn a_collision_is_found_and_the_parameters_that_jumped_are_named() {
    for seed in 100..110 {
        let (first, second) = two_sessions(seed, |robot| {
            robot.links[2].theta_offset_rad += 0.1f64.to_radians();
            robot.links[3].a_mm -= 0.3;
        });
        let changes = compared(&paper_robot(), &first, &second);
        assert_eq!(changes.kind, Some(ChangeKind::Collision));
        let warning = &changes.warnings[0];
        assert!(
            warning.code == "robot_changed" && warning.detail.contains("collision"),
            "{}",
            warning.detail
        );
        let first_two: Vec<&str> = names(&changes)[..2].to_vec();
        assert_eq!(of_the_robot(&first_two), ["a_4", "theta_offset_3"]);
        let turned = changes
            .all
            .iter()
            .find(|c| c.name == "theta_offset_3")
            .unwrap();
        // Within four of its own standard deviations.
        assert!(
            (turned.delta - 0.1).abs() < 4.0 * 0.1 / turned.sigmas,
            "{turned:?}"
        );
    }
}

#[test]
fn what_happened_to_the_papers_robot_between_its_sessions_is_told_apart() {
    let against_first =
        |name: &str| compared(&paper_robot(), &paper_set("first.csv"), &paper_set(name));
    let unchanged = against_first("followup_unchanged.csv");
    assert_eq!(
        (
            unchanged.kind,
            unchanged.all.len(),
            unchanged.warnings.len()
        ),
        (None, 0, 0)
    );
    let drifted = against_first("followup_drifted.csv");
    assert_eq!(drifted.kind, Some(ChangeKind::Drift));
    let collision = against_first("followup_collision.csv");
    assert_eq!(collision.kind, Some(ChangeKind::Collision));
    assert_eq!(
        of_the_robot(&names(&collision)[..3]),
        ["a_3", "theta_offset_2", "theta_offset_3"]
    );
    for (name, planted) in [
        ("theta_offset_2", 0.2),
        ("theta_offset_3", -0.15),
        ("a_3", 0.1),
    ] {
        let found = collision.all.iter().find(|c| c.name == name).unwrap().delta;
        // The difference of two linearisations that are 1 mm and 0.2° apart.
        assert!((found - planted).abs() < 2e-3, "{name}: {found}");
    }
}

#[test]
fn an_arm_whose_lengths_are_all_in_its_tool_is_judged_by_its_tool() {
    let wrist = Link {
        a_mm: 0.0,
        alpha_rad: 1.5,
        d_mm: 0.0,
        theta_offset_rad: 0.0,
        beta_rad: 0.0,
    };
    let mut model = KinematicModel::nominal(&[wrist; 3], 1);
    model.targets_mm[0] = Vector3::new(300.0, 0.0, 400.0);
    assert_eq!(model.reach_mm(), 500.0);
}

#[test]
fn the_same_points_again_have_not_changed() {
    let (first, _) = two_sessions(7, |_| ());
    let changes = compared(&paper_robot(), &first, &first);
    assert_eq!(
        (changes.kind, changes.all.len(), changes.warnings.len()),
        (None, 0, 0)
    );
}

#[test]
fn of_points_that_fit_no_robot_nothing_is_said_to_have_changed_or_not() {
    let (first, mut second) = two_sessions(1, |_| ());
    // Each row has the position of another one.
    let n = second.points.len();
    let positions: Vec<_> = second.points.iter().map(|p| p.position_mm).collect();
    for (row, point) in second.points.iter_mut().enumerate() {
        point.position_mm = positions[(row + n / 3) % n];
    }
    let request = CalibrationRequest {
        method: Method::LeastSquares,
        previous: Some(PreviousSession {
            set: first,
            frames: None,
            estimate: None,
        }),
        ..CalibrationRequest::new(paper_robot(), second)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
    let codes: Vec<&str> = report.warnings.iter().map(|told| told.code).collect();
    assert!(codes.contains(&"no_fit"), "{codes:?}");
    assert!(report.changes.is_none());
    assert!(
        !codes.contains(&"placement_changed") && !codes.contains(&"robot_changed"),
        "{codes:?}"
    );
}
