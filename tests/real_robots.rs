//! Measured robots, links alone, beside scipy's `least_squares` (24 link parameters, base and targets) on the same splits. The tables are in
//! `docs/identification.md`, scipy's numbers in `docs/oracles`.

#[path = "support/data.rs"]
mod data;

use data::{real_data, robot};
use kincal::calibration::request::VerifySource;
use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use kincal::kinematics::Robot;
use kincal::measurement::{Frame, MeasurementSet, Point, csv, split};
use std::ops::ControlFlow;
use std::path::Path;

/// `docs/oracles/scipy_least_squares.py` on these splits, mm rms on the points to verify.
const SCIPY: &str = include_str!("../docs/oracles/scipy_least_squares.csv");
/// What is to be reached on the splits of the files, mm rms: scipy's, cut off after three digits.
const LIMITS: [(&str, f64); 2] = [("motoman_ma1400", 0.415), ("qkm_hl6", 0.442)];

fn scipy(name: &str, split: &str) -> f64 {
    let key = format!("{name},{split},");
    SCIPY
        .lines()
        .find_map(|line| line.strip_prefix(&key))
        .and_then(|value| value.parse().ok())
        .unwrap()
}

fn set(path: &Path) -> MeasurementSet {
    csv::parse(&std::fs::read(path).unwrap(), Frame::Instrument, 6).unwrap()
}

/// Both visits of the motoman are one set: the instrument had not moved.
fn robot_and_set(root: &Path, name: &str) -> (Robot, MeasurementSet) {
    let folder = root.join(name);
    let files: &[&str] = if name == "qkm_hl6" {
        &["set.csv"]
    } else {
        &["visit_1.csv", "visit_2.csv"]
    };
    let points = files
        .iter()
        .flat_map(|file| set(&folder.join(file)).points)
        .enumerate();
    let points = points
        .map(|(row, p)| Point {
            sequence: row as i64,
            ..p
        })
        .collect();
    (
        robot(&folder.join("robot.json")),
        MeasurementSet::new(Frame::Instrument, points),
    )
}

fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn verify_rms(report: &CalibrationReport) -> f64 {
    report.verify.unwrap().after.rms_mm
}

fn nothing_moved_and_nothing_is_wild(report: &CalibrationReport) -> bool {
    report
        .warnings
        .iter()
        .all(|w| !w.code.ends_with("_moved") && !w.code.starts_with("outliers"))
}

#[test]
fn measured_robots_are_identified_at_least_as_well_as_scipy_does() {
    let Some(root) = real_data() else { return };
    for (name, limit_mm) in LIMITS {
        let (robot, set) = robot_and_set(&root, name);
        let report = run(&CalibrationRequest::new(robot.clone(), set.clone()));
        println!(
            "{name}: {:.4} mm, scipy {:.4} mm",
            verify_rms(&report),
            scipy(name, "column")
        );
        assert!(
            verify_rms(&report) <= limit_mm.min(scipy(name, "column")),
            "{name}: {}",
            verify_rms(&report)
        );
        assert!(
            nothing_moved_and_nothing_is_wild(&report),
            "{name}: {:?}",
            report.warnings
        );
        let mut sum = 0.0;
        for seed in 0..8 {
            let mut split_set = set.clone();
            let subsets = split::by_fraction(&set, 0.5, seed);
            split_set
                .points
                .iter_mut()
                .zip(subsets)
                .for_each(|(p, subset)| p.subset = Some(subset));
            let report = run(&CalibrationRequest::new(robot.clone(), split_set));
            sum += verify_rms(&report) / scipy(name, &seed.to_string());
        }
        println!("{name}: mean ratio over 8 splits {:.4}", sum / 8.0);
        assert!(sum / 8.0 <= 1.0, "{name}: mean ratio {}", sum / 8.0);
    }
}

#[test]
fn what_one_visit_identified_holds_on_the_other() {
    let Some(root) = real_data() else { return };
    let folder = root.join("motoman_ma1400");
    let robot = robot(&folder.join("robot.json"));
    for (first, second) in [
        ("visit_1.csv", "visit_2.csv"),
        ("visit_2.csv", "visit_1.csv"),
    ] {
        let mut request = CalibrationRequest::new(robot.clone(), set(&folder.join(first)));
        request.verify = VerifySource::Set(set(&folder.join(second)));
        let verify = run(&request).verify.unwrap();
        println!(
            "{first} on {second}: {:.3} mm, nominal {:.3} mm",
            verify.after.rms_mm, verify.before.rms_mm
        );
        // half of what the nominal robot misses by: another session, base and target placed anew for both
        assert!(
            verify.after.rms_mm < 0.55 * verify.before.rms_mm,
            "{first} on {second}: {}",
            verify.after.rms_mm
        );
    }
}
