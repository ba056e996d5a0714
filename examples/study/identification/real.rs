//! Measured robots, beside scipy on the same splits.

use crate::data::{real_data, robot};
use crate::measured_robots::{robots, set, with_split};
use kincal::calibration::request::{Loss, VerifySource};
use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use kincal::measurement::{MeasurementSet, Point, Subset, split};
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

/// Numbers of `docs/oracles/scipy_least_squares.py`.
const SCIPY: &str = include_str!("../../../docs/oracles/scipy_least_squares.csv");
const SEEDS: u64 = 8;

/// The column of the file, then seeds 0 to 7.
fn splits(set: &MeasurementSet) -> Vec<(String, MeasurementSet)> {
    let seeded = (0..SEEDS).map(|seed| {
        let subsets = split::by_fraction(set, 0.5, seed);
        (seed.to_string(), with_split(set, |row, _| subsets[row]))
    });
    std::iter::once(("column".to_string(), set.clone()))
        .chain(seeded)
        .collect()
}

fn run(request: &CalibrationRequest) -> (CalibrationReport, f64) {
    let start = Instant::now();
    let report = calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap();
    (report, start.elapsed().as_secs_f64() * 1e3)
}

fn remarks(report: &CalibrationReport) -> String {
    let found: Vec<String> = report
        .warnings
        .iter()
        .filter(|w| {
            w.code.ends_with("_moved")
                || w.code.starts_with("outliers")
                || w.code == "verify_extrapolates"
        })
        .map(|w| {
            if w.rows.len() > 10 {
                format!("{} at {} points", w.code, w.rows.len())
            } else {
                format!("{} {:?}", w.code, w.rows)
            }
        })
        .collect();
    found.join(", ")
}

/// Writes each split as a file, for other programs.
pub fn write_splits(folder: &Path) {
    let Some(root) = real_data() else { return };
    for (name, _, set) in robots(&root) {
        std::fs::copy(
            root.join(name).join("robot.json"),
            folder.join(format!("{name}.json")),
        )
        .unwrap();
        for (seed, set) in splits(&set) {
            let mut text = String::from(
                "configuration,target,subset,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_mm,y_mm,z_mm\n",
            );
            for p in &set.points {
                let subset = if p.subset == Some(Subset::Identify) {
                    "identify"
                } else {
                    "verify"
                };
                write!(text, "{},{},{subset}", p.configuration, p.target).unwrap();
                p.q_rad
                    .iter()
                    .chain(p.position_mm.iter())
                    .for_each(|v| write!(text, ",{v:?}").unwrap());
                text.push('\n');
            }
            std::fs::write(folder.join(format!("{name}-{seed}.csv")), text).unwrap();
        }
    }
}

/// The tables.
pub fn tables() {
    let Some(root) = real_data() else { return };
    println!("## Measured robots: links alone, beside scipy on the same splits\n");
    println!(
        "Everything by default, splits by configuration. scipy: `docs/oracles/scipy_least_squares.py`, 24 link parameters + base + targets.\n"
    );
    println!(
        "| set | split | nominal, mm rms | identified | scipy | ratio | squares alone | time, ms | remarks |\n|---|---|---|---|---|---|---|---|---|"
    );
    for (name, robot, set) in robots(&root) {
        let (mut sum, mut n) = (0.0, 0.0);
        for (seed, set) in splits(&set) {
            let mut request = CalibrationRequest::new(robot.clone(), set);
            let (report, ms) = run(&request);
            request.options.loss = Some(Loss::Squares);
            let squares = run(&request).0.verify.unwrap().after.rms_mm;
            let verify = report.verify.unwrap();
            let key = format!("{name},{seed},");
            let scipy: f64 = SCIPY
                .lines()
                .find_map(|l| l.strip_prefix(&key))
                .and_then(|v| v.parse().ok())
                .unwrap_or(f64::NAN);
            let ratio = verify.after.rms_mm / scipy;
            if seed != "column" {
                (sum, n) = (sum + ratio, n + 1.0);
            }
            println!(
                "| {name} | {seed} | {:.3} | {:.4} | {scipy:.4} | {ratio:.4} | {squares:.4} | {ms:.0} | {} |",
                verify.before.rms_mm,
                verify.after.rms_mm,
                remarks(&report)
            );
        }
        println!(
            "| {name} | mean of seeds 0 to 7 | | | | {:.4} | | | |",
            sum / n
        );
    }
    println!();
    surfaces(&root);
    sessions(&root);
}

/// The motoman's three surfaces: 1, 1001, 2002 and so on.
fn surface(p: &Point) -> u32 {
    p.configuration.parse::<u32>().unwrap_or(0) / 1000
}

fn surfaces(root: &Path) {
    println!("## One of three surfaces left out and predicted (motoman_ma1400, both visits)\n");
    println!(
        "| surface | points | nominal, mm rms | identified | remarks |\n|---|---|---|---|---|"
    );
    let (_, robot, set) = robots(root).swap_remove(0);
    for left_out in 0..3 {
        let set = with_split(&set, |_, p| {
            if surface(p) == left_out {
                Subset::Verify
            } else {
                Subset::Identify
            }
        });
        let (report, _) = run(&CalibrationRequest::new(robot.clone(), set));
        let verify = report.verify.unwrap();
        println!(
            "| {left_out} | {} | {:.3} | {:.3} | {} |",
            verify.n_points,
            verify.before.rms_mm,
            verify.after.rms_mm,
            remarks(&report)
        );
    }
    println!();
}

fn sessions(root: &Path) {
    println!(
        "## One visit identified, the other verified (motoman_ma1400; base and target placed anew)\n"
    );
    println!(
        "| identified | verified | nominal, mm rms | identified, on the other visit | remarks |\n|---|---|---|---|---|"
    );
    let folder = root.join("motoman_ma1400");
    let robot = robot(&folder.join("robot.json"));
    for (first, second) in [("visit_1", "visit_2"), ("visit_2", "visit_1")] {
        let file = |name: &str| set(&folder.join(format!("{name}.csv")));
        let mut request = CalibrationRequest::new(robot.clone(), file(first));
        request.verify = VerifySource::Set(file(second));
        let (report, _) = run(&request);
        let verify = report.verify.unwrap();
        println!(
            "| {first} | {second} | {:.3} | {:.3} | {} |",
            verify.before.rms_mm,
            verify.after.rms_mm,
            remarks(&report)
        );
    }
    println!();
}
