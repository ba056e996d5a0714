//! Steps and drift during the measurement: false alarms and detection. Prints `docs/drift.md`.
//!
//! `cargo run --release --example study drift [n_campaigns] > docs/drift.md`

use crate::drifts::{NOISE_MM, ROWS, VISITS, What, counts};

/// Runs the study.
pub fn study(arguments: &[String]) {
    let n: u64 = arguments
        .first()
        .cloned()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1000);
    println!(
        "# Steps and drift\n\nMade by `cargo run --release --example study drift {n} > docs/drift.md`.\n\n\
         {n} simulated campaigns per row: {ROWS} rows, of which {VISITS} are visits of one pose, noise of {NOISE_MM} mm per coordinate; a slip is before a random row, the \
         ends included. Drift is that of base or instrument, in a random direction, from the first row to the last one.\n\n\
         | campaign | a step is told | within one row of where it was | `drift` | `warm_up` |\n|---|---:|---:|---:|---:|"
    );
    for what in What::ALL {
        let [steps, near, drift, warm_up] =
            counts(what, 0..n).map(|c| format!("{:.1} %", 100.0 * c as f64 / n as f64));
        let near = match what {
            What::SlipOfBase | What::SlipOfTarget => near,
            _ => "–".into(),
        };
        println!(
            "| {} | {steps} | {near} | {drift} | {warm_up} |",
            what.name()
        );
    }
}
