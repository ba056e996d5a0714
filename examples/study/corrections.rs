//! The tables of docs/corrections.md. `cargo run --release --example study corrections [real|geometric|simulated|time] [n [first seed]]`

mod measured;
mod simulated;

use kincal::calibration::{CalibrationReport, CalibrationRequest, calibrate};
use std::ops::ControlFlow;

/// The identification of a request.
pub fn run(request: &CalibrationRequest) -> CalibrationReport {
    calibrate(request, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// The corrections that were kept, in words.
pub fn kept(report: &CalibrationReport) -> String {
    let kept = report
        .corrections
        .iter()
        .flatten()
        .filter(|e| e.kept)
        .map(|e| e.kind.as_str());
    kept.collect::<Vec<_>>().join(", ")
}

/// Median, smallest and largest.
pub fn spread(mut values: Vec<f64>) -> (f64, f64, f64) {
    values.sort_by(f64::total_cmp);
    (
        values[values.len() / 2],
        values[0],
        values[values.len() - 1],
    )
}

/// Runs the study.
pub fn study(arguments: &[String]) {
    let mut arguments = arguments.iter().cloned();
    let table = arguments.next().unwrap_or_default();
    let n: usize = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(100);
    let first_seed: u64 = arguments
        .next()
        .and_then(|seed| seed.parse().ok())
        .unwrap_or(0);
    if table.is_empty() || table == "real" {
        measured::tables();
    }
    if table.is_empty() || table == "geometric" {
        simulated::geometric(n, first_seed);
    }
    if table.is_empty() || table == "simulated" {
        simulated::real_robots(n.min(40));
    }
    if table.is_empty() || table == "time" {
        simulated::time();
    }
}
