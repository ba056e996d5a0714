//! A report as text, for people at a terminal.

use crate::wire::job::{Method, Model};
use crate::wire::report_shape::{ComparisonReport, ErrorsReport, ParameterReport, Report, SubsetReport};
use std::fmt::Write;

/// The whole report: errors before and after, methods side by side, parameters, warnings.
pub fn report(report: &Report) -> String {
    let mut text = String::new();
    let model = if report.model == Model::Paper { "paper" } else { "complete" };
    line(&mut text, format!("{} on the {model} model: {}", name(report.method), report.method_reason));
    line(
        &mut text,
        format!(
            "{} iterations, F = {} mm², {:.0} ms, rank {} of {} parameters",
            report.n_iterations,
            number(report.cost_mm2),
            report.duration_ms,
            report.identifiability.rank,
            report.identifiability.n_parameters
        ),
    );
    line(&mut text, String::new());
    line(&mut text, format!("{:<24}{:>10}{:>10}{:>10}{:>10}", "position error, mm", "mean", "std", "rms", "max"));
    halves(&mut text, "identify", Some(&report.identify));
    halves(&mut text, "verify", report.verify.as_ref());
    comparison(&mut text, &report.comparison);
    parameters(&mut text, &report.parameters);
    for warning in &report.warnings {
        line(&mut text, format!("\nwarning ({}): {}", warning.code, warning.detail));
    }
    text
}

fn line(text: &mut String, line: String) {
    // writing to a String cannot fail
    let _ = writeln!(text, "{line}");
}

fn halves(text: &mut String, name: &str, half: Option<&SubsetReport>) {
    let Some(half) = half else { return };
    let row =
        |e: &ErrorsReport| format!("{:>10}{:>10}{:>10}{:>10}", number(e.mean_mm), number(e.std_mm), number(e.rms_mm), number(e.max_mm));
    line(text, format!("{:<24}{}", format!("{name} ({}), before", half.n_points), row(&half.before)));
    line(text, format!("{:<24}{}", format!("{name} ({}), after", half.n_points), row(&half.after)));
    if let Some(corrected) = half.corrected.as_ref().filter(|corrected| **corrected != half.after) {
        line(text, format!("{:<24}{}", format!("{name} ({}), corrected", half.n_points), row(corrected)));
    }
}

fn comparison(text: &mut String, rows: &[ComparisonReport]) {
    line(text, format!("\n{:<24}{:>12}{:>14}{:>12}{:>18}", "on the same points", "iterations", "F, mm²", "time, ms", "verify rms, mm"));
    for row in rows {
        let rms = row.verify_after.map_or("–".into(), |e| number(e.rms_mm));
        line(text, format!("{:<24}{:>12}{:>14}{:>12.1}{rms:>18}", row.method, row.n_iterations, number(row.cost_mm2), row.duration_ms));
    }
}

fn parameters(text: &mut String, rows: &[ParameterReport]) {
    line(text, format!("\n{:<16}{:>5}{:>14}{:>14}{:>12}{:>12}", "parameter", "unit", "nominal", "identified", "delta", "± std"));
    for row in rows {
        let std = match (row.identifiable, row.std_uncertainty) {
            (false, _) => "not seen".into(),
            (true, Some(std)) => number(std),
            (true, None) => "–".into(),
        };
        line(text, format!("{:<16}{:>5}{:>14.5}{:>14.5}{:>12.5}{std:>12}", row.name, row.unit, row.nominal, row.identified, row.delta));
    }
}

/// Four significant digits, in powers of ten where it is tiny.
pub fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if size < 1e-3 => format!("{value:.2e}"),
        size if size < 100.0 => format!("{value:.4}"),
        _ => format!("{value:.1}"),
    }
}

/// A method's name as on the wire.
pub fn name(method: Method) -> &'static str {
    method.to_core().name()
}
