//! Links alone, beside two other estimators on the same splits: measured robots, and simulated ones of odd kinds. Prints `docs/estimator.md`.
//!
//! `cargo run --release --example study estimator DIR ORACLES.csv… > docs/estimator.md`, with the folders and files that `docs/oracles/estimator.py` made.

use crate::data;
use kincal::calibration::request::{CorrectionsChoice, VerifySource};
use kincal::calibration::{CalibrationRequest, Model, calibrate};
use kincal::measurement::Frame;
use kincal::measurement::table::own_form;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// One case, verify rms, mm.
struct Case {
    /// Robot or family, what kind of split, and which.
    name: String,
    scipy_mm: f64,
    map_mm: f64,
    own_mm: f64,
}

/// Runs the study.
pub fn study(arguments: &[String]) {
    let [folder, oracles @ ..] = arguments else {
        panic!("study estimator DIR ORACLES.csv…");
    };
    let cases: Vec<Case> = oracles
        .iter()
        .flat_map(|file| read(Path::new(folder), file))
        .collect();
    println!("# Comparison with other estimators, links alone\n");
    println!(
        "Made by `cargo run --release --example study estimator DIR docs/oracles/estimator*.csv`, of the sets that `docs/oracles/estimator.py` makes. \
         Verify rms, mm. scipy: unregularised least squares from nominal; MAP: maximum a posteriori in numpy with normal priors.\n"
    );
    let (odd, measured): (Vec<_>, Vec<_>) =
        cases.iter().partition(|case| case.name.starts_with("odd."));
    of_measured(&measured);
    of_odd(&odd);
}

fn read(folder: &Path, oracles: &str) -> Vec<Case> {
    let text = std::fs::read_to_string(oracles).unwrap();
    let case = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        let own_mm = own_rms_mm(&folder.join(fields[0]));
        eprintln!("{line},{own_mm:.5}");
        Case {
            name: fields[0].into(),
            scipy_mm: fields[1].parse().unwrap(),
            map_mm: fields[2].parse().unwrap(),
            own_mm,
        }
    };
    text.lines().skip(1).map(case).collect()
}

fn own_rms_mm(folder: &Path) -> f64 {
    let robot = data::robot(&folder.join("robot.json"));
    let set = std::fs::read(folder.join("set.csv")).unwrap();
    let set = own_form::parse(&set, Frame::Instrument, robot.links.len()).unwrap();
    let request = CalibrationRequest {
        model: Some(Model::Complete),
        corrections: Some(CorrectionsChoice::Off),
        verify: VerifySource::Subset,
        ..CalibrationRequest::new(robot, set)
    };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(()));
    report.unwrap().verify.unwrap().after.rms_mm
}

/// Means over the splits of a set.
fn of_measured(cases: &[&Case]) {
    let mut sets: BTreeMap<&str, Vec<&Case>> = BTreeMap::new();
    for case in cases {
        let set = case.name.rsplit_once('.').unwrap().0;
        sets.entry(set).or_default().push(case);
    }
    println!("## Measured robots\n");
    println!(
        "split: half of the configurations to identify; few: 15 of them; column: as the file says.\n"
    );
    println!(
        "| set | splits | scipy | MAP | kincal | kincal / better of both | kincal / scipy |\n|---|---|---|---|---|---|---|"
    );
    for (name, cases) in sets {
        let mean = |of: fn(&Case) -> f64| {
            cases.iter().map(|case| of(case)).sum::<f64>() / cases.len() as f64
        };
        let (scipy, map, own) = (mean(|c| c.scipy_mm), mean(|c| c.map_mm), mean(|c| c.own_mm));
        println!(
            "| {name} | {} | {scipy:.4} | {map:.4} | {own:.4} | {:.4} | {:.4} |",
            cases.len(),
            own / scipy.min(map),
            own / scipy
        );
    }
}

/// Each family of simulated robots: the means, and the worst of its robots.
fn of_odd(cases: &[&Case]) {
    let mut families: BTreeMap<&str, Vec<&Case>> = BTreeMap::new();
    for case in cases {
        let family = case.name["odd.".len()..].split(".seed.").next().unwrap();
        families.entry(family).or_default().push(case);
    }
    println!("\n## Simulated robots of odd kinds\n");
    println!(
        "| family | robots | scipy | MAP | kincal | mean of kincal / scipy | largest |\n|---|---|---|---|---|---|---|"
    );
    let ratio = |case: &&Case| case.own_mm / case.scipy_mm;
    for (name, cases) in families {
        let mean =
            |of: &dyn Fn(&&Case) -> f64| cases.iter().map(of).sum::<f64>() / cases.len() as f64;
        println!(
            "| {name} | {} | {:.5} | {:.5} | {:.5} | {:.4} | {:.4} |",
            cases.len(),
            mean(&|c| c.scipy_mm),
            mean(&|c| c.map_mm),
            mean(&|c| c.own_mm),
            mean(&ratio),
            cases.iter().map(ratio).fold(0.0, f64::max)
        );
    }
    let largest = cases.iter().map(ratio).fold(0.0, f64::max);
    println!(
        "\n{} robots; the largest ratio to scipy is {largest:.4}.",
        cases.len()
    );
}
