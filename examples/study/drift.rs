//! Steps, drift, play and unsettled joint values during the measurement: false alarms and detection. Prints the tables of `docs/drift.md`.
//!
//! `cargo run --release --example study drift [n_campaigns [part of the name of a row]]`

use crate::drifts::{Counts, NOISE_MM, ROWS, VISITS, What, counts};
use crate::joint_errors::{self, CONFIGURATIONS, JointErrors};

/// Runs the study.
pub fn study(arguments: &[String]) {
    let n: u64 = arguments
        .first()
        .cloned()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1000);
    let part = arguments.get(1).map_or("", String::as_str);
    let percent = |count: usize| format!("{:.1} %", 100.0 * count as f64 / n as f64);
    let row = |name: String, near: Option<usize>, told: Counts| {
        let near = near.map_or_else(|| "–".into(), percent);
        println!(
            "| {name} | {} | {near} | {} | {} | {} | {} |",
            percent(told.step),
            percent(told.drift),
            percent(told.warm_up),
            percent(told.backlash),
            percent(told.err_together),
        );
    };
    let head = "| campaign | a step is told | within one row of where it was | `drift` | `warm_up` | `backlash` | `configurations_err_together` |\n|---|---:|---:|---:|---:|---:|---:|";
    println!(
        "{n} campaigns per row: {ROWS} rows, of which {VISITS} are visits of one pose, noise of {NOISE_MM} mm per coordinate.\n\n{head}"
    );
    for what in What::ALL.into_iter().filter(|w| w.name().contains(part)) {
        let told = counts(what, 0..n);
        let is_slip = matches!(what, What::SlipOfBase | What::SlipOfTarget);
        row(what.name(), is_slip.then_some(told.step_near), told);
    }
    println!(
        "\n{n} campaigns per row: {CONFIGURATIONS} configurations, noise of {NOISE_MM} mm per coordinate.\n\n{head}"
    );
    for errors in JointErrors::ALL
        .into_iter()
        .filter(|e| e.name().contains(part))
    {
        row(errors.name(), None, joint_errors::counts(errors, 0..n));
    }
}
