//! A robot and its measurements of another size are identified and corrected alike: no length in mm decides there. The oracle is the same
//! request in another unit: lengths, positions and noise times a power of two, which changes no rounding of a product.

use crate::data::paper_robot;
use crate::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use kincal::compensation::{Compensation, Mode, Status, Tool};
use kincal::identification::KinematicModel;
use kincal::kinematics::Robot;
use kincal::measurement::{MeasurementSet, Subset};
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};
use rand::RngExt;
use std::ops::ControlFlow;

/// An arm of 39 mm and one of 40 m (sum of |a| and |d|), beside the one of 2.5 m.
const SIZES: [f64; 2] = [1.0 / 64.0, 16.0];
/// Relative difference of lengths, and difference of angles in rad: where least squares ends, and rounding in sums of mm and rad.
const ALIKE: f64 = 1e-6;

/// A robot, and a set of 60 configurations with a noise of 0.05 mm.
struct Made {
    robot: Robot,
    truth: KinematicModel,
    set: MeasurementSet,
    random: Normal,
}

impl Made {
    fn new(seed: u64, n_targets: usize, sag_rad: f64) -> Self {
        let campaign = Campaign {
            n_configurations: 60,
            n_targets,
            noise_mm: 0.05,
            sag_rad,
            ..Campaign::PLAIN
        };
        let robot = limited(paper_robot());
        let mut random = Normal::new(seed);
        let truth = true_robot(&robot, n_targets, &mut random);
        let poses = poses(campaign.n_configurations, &mut random);
        let mut set = measure(&truth, &poses, &campaign, &mut random);
        for (row, point) in set.points.iter_mut().enumerate() {
            let is_even = (row / n_targets).is_multiple_of(2);
            point.subset = Some(if is_even {
                Subset::Identify
            } else {
                Subset::Verify
            });
        }
        Self {
            robot,
            truth,
            set,
            random,
        }
    }

    fn request(&self, size: f64) -> CalibrationRequest {
        let (mut robot, mut set) = (self.robot.clone(), self.set.clone());
        for link in &mut robot.links {
            link.a_mm *= size;
            link.d_mm *= size;
        }
        for point in &mut set.points {
            point.position_mm *= size;
            point.std_mm = point.std_mm.map(|std| std * size);
        }
        CalibrationRequest::new(robot, set)
    }
}

fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn warnings(report: &CalibrationReport) -> Vec<(&'static str, Vec<usize>)> {
    let warnings = report.warnings.iter();
    warnings.map(|w| (w.code, w.rows.clone())).collect()
}

fn assert_alike(what: &str, a: f64, b: f64, size: f64) {
    assert!((a - b).abs() <= ALIKE * size, "{what}: {a} and {b}");
}

/// Both answers, the second in units of `size`.
fn assert_same(what: &str, one: &CalibrationReport, other: &CalibrationReport, size: f64) {
    assert_eq!(warnings(one), warnings(other), "{what}, {size}");
    assert_eq!(
        (one.identifiability.rank, one.target_segments.as_slice()),
        (other.identifiability.rank, other.target_segments.as_slice()),
        "{what}, {size}"
    );
    for (k, (a, b)) in one.links.iter().zip(&other.links).enumerate() {
        let name = |quantity| format!("{what}, {size}: {quantity} of link {}", k + 1);
        assert_alike(&name("a"), a.a_mm, b.a_mm / size, 1000.0);
        assert_alike(&name("d"), a.d_mm, b.d_mm / size, 1000.0);
        assert_alike(&name("alpha"), a.alpha_rad, b.alpha_rad, 1.0);
        assert_alike(&name("theta"), a.theta_offset_rad, b.theta_offset_rad, 1.0);
    }
    let kinds = |r: &CalibrationReport| {
        let tried = r.corrections.iter().flatten();
        tried.map(|e| (e.kind.clone(), e.kept)).collect::<Vec<_>>()
    };
    assert_eq!(kinds(one), kinds(other), "{what}, {size}");
    let (a, b) = (one.verify.unwrap(), other.verify.unwrap());
    assert_alike(what, a.after.rms_mm, b.after.rms_mm / size, 1.0);
    let uncertain = |r: &CalibrationReport| r.tool_uncertainty.map_or(f64::NAN, |t| t.mean_mm);
    let (a, b) = (uncertain(one), uncertain(other) / size);
    assert!(
        (a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-3 * a,
        "{what}, {size}: {a} {b}"
    );
}

/// `told` is a warning that the answer has, at every size.
fn assert_alike_at_every_size(what: &str, made: &Made, told: Option<&str>) {
    let one = run(&made.request(1.0));
    let codes: Vec<&str> = one.warnings.iter().map(|w| w.code).collect();
    assert!(
        told.is_none_or(|code| codes.contains(&code)),
        "{what}: {codes:?}"
    );
    for size in SIZES {
        assert_same(what, &one, &run(&made.request(size)), size);
    }
}

#[test]
fn an_arm_of_39_mm_and_one_of_40_m_are_identified_alike() {
    assert_alike_at_every_size("plain", &Made::new(900, 1, 0.0), None);
    assert_alike_at_every_size("two targets", &Made::new(901, 2, 0.0), None);
    let mut noiseless = Made::new(902, 1, 0.0);
    for point in &mut noiseless.set.points {
        point.position_mm = noiseless.truth.position(&point.q_rad, 0);
    }
    assert_alike_at_every_size("without noise", &noiseless, None);
}

/// Targets near a singularity, where lengths and angles are weighed against each other, among them.
#[test]
fn targets_are_corrected_alike_at_every_size() {
    let made = Made::new(940, 1, 0.0);
    let mut random = Normal::new(941);
    let mut targets = poses(20, &mut random);
    for (target, bend_deg) in targets.iter_mut().zip([0.1f64, 0.5, 1.0, 1.6, 2.0]) {
        target[4] = made.robot.links[4].theta_offset_rad - bend_deg.to_radians();
    }
    let corrected = |size: f64| {
        let robot = made.request(size).robot;
        let mut links = made.truth.links.clone();
        links.iter_mut().for_each(|link| {
            link.a_mm *= size;
            link.d_mm *= size;
        });
        let mut tool = IsometryMatrix3::translation(40.0 * size, 10.0 * size, 150.0 * size);
        tool.append_rotation_wrt_center_mut(&Rotation3::new(Vector3::new(0.3, 0.2, -0.4)));
        let compensation = Compensation::new(&robot, &links);
        let correct = |q: &Vec<f64>| compensation.correct(q, &Tool::Tcp(tool), Mode::Pose);
        targets.iter().map(correct).collect::<Vec<_>>()
    };
    let one = corrected(1.0);
    let near_singular = one.iter().filter(|c| c.status == Status::NearSingular);
    assert!((1..10).contains(&near_singular.count()));
    for size in SIZES {
        for (k, (a, b)) in one.iter().zip(corrected(size)).enumerate() {
            assert_eq!(a.status, b.status, "target {k}, {size}");
            for (a, b) in a.q_controller_rad.iter().zip(&b.q_controller_rad) {
                assert_alike(&format!("target {k}, {size}"), *a, *b, 1.0);
            }
        }
    }
}

#[test]
fn gross_rows_are_named_alike_at_every_size() {
    let mut made = Made::new(910, 1, 0.0);
    for row in [3, 20, 41] {
        let direction = made.random.vector().normalize();
        made.set.points[row].position_mm += direction * made.random.0.random_range(5.0..1000.0);
    }
    assert_alike_at_every_size("gross rows", &made, Some("outliers"));
}

#[test]
fn what_moved_and_stations_are_found_alike_at_every_size() {
    let mut slipped = Made::new(920, 1, 0.0);
    let mut after = slipped.truth.clone();
    after.targets_mm[0] += Vector3::new(1.2, -0.9, 1.0);
    for point in &mut slipped.set.points[30..] {
        point.position_mm +=
            after.position(&point.q_rad, 0) - slipped.truth.position(&point.q_rad, 0);
    }
    assert_alike_at_every_size("slipped", &slipped, Some("target_moved"));
    let mut stations = Made::new(921, 1, 0.0);
    let turn = Rotation3::new(Vector3::new(0.3, -0.2, 2.0));
    for (row, point) in stations.set.points.iter_mut().enumerate() {
        point.station = Some(if row < 25 { "door" } else { "window" }.into());
        if row < 25 {
            point.position_mm = turn * point.position_mm + Vector3::new(4000.0, -700.0, 90.0);
        }
    }
    assert_alike_at_every_size("stations", &stations, None);
}

#[test]
fn sag_and_joints_that_were_never_mastered_are_found_alike_at_every_size() {
    assert_alike_at_every_size("sag", &Made::new(930, 2, 1e-3), None);
    let mut unmastered = Made::new(931, 1, 0.0);
    for (link, off_deg) in [(1, 20.0f64), (3, -35.0)] {
        unmastered.truth.links[link].theta_offset_rad += off_deg.to_radians();
    }
    for point in &mut unmastered.set.points {
        point.position_mm =
            unmastered.truth.position(&point.q_rad, 0) + unmastered.random.vector() * 0.05;
    }
    assert_alike_at_every_size(
        "never mastered",
        &unmastered,
        Some("implausible_parameters"),
    );
}
