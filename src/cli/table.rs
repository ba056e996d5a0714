//! A report as text for a terminal.

use super::check_table::quick_check;
use super::remedy::with_options;
use crate::release::{why_no_evidence, why_same_upload};
use crate::report_page::words;
use crate::wire::job::{Method, Model};
use crate::wire::report_shape::{
    ComparisonReport, CorrectionReport, ErrorsReport, Evidence, ParameterReport,
    RepeatabilityReport, Report, SubsetReport,
};
use crate::wire::sessions::PooledReport;
use std::fmt::Write;

/// Smallest error that is printed as a number, mm: no instrument resolves a tenth of a micrometre.
const SMALLEST_MM: f64 = 1e-4;

/// The whole report: errors before and after, strength of the evidence, comparison of methods, parameters, corrections, repeatability, warnings.
pub fn report(report: &Report) -> String {
    let mut text = if is_verification(report) {
        verified(report)
    } else {
        identified(report)
    };
    pooled(&mut text, report.pooled.as_ref());
    repeatability(&mut text, report.repeatability.as_ref());
    for warning in &report.warnings {
        line(
            &mut text,
            format!(
                "\nwarning: {} ({}): {}",
                words::warning(&warning.code),
                warning.code,
                with_options(&warning.detail)
            ),
        );
        let advice = words::advice(&warning.code, &report.warnings);
        if !advice.is_empty() {
            line(&mut text, format!("  {}", advice.join(" ")));
        }
    }
    text
}

/// True if the job only scored a parameter set.
fn is_verification(report: &Report) -> bool {
    report.termination == "verified"
}

/// The scored parameter set and its errors.
fn verified(report: &Report) -> String {
    let mut text = String::new();
    let what = report
        .parameter_set_from
        .as_ref()
        .map_or("verification".into(), |id| {
            format!("verification of the parameter set {id}")
        });
    line(&mut text, format!("{what}: {}", report.method_reason));
    if let Some(check) = &report.check {
        text.push_str(&quick_check(check));
    }
    line(&mut text, String::new());
    line(&mut text, columns());
    if let Some(half) = &report.verify {
        line(
            &mut text,
            row(&format!("nominal ({})", half.n_points), &half.before),
        );
        if half.after != half.before {
            line(
                &mut text,
                row(
                    &format!("these parameters ({})", half.n_points),
                    &half.after,
                ),
            );
        }
        if let Some(corrected) = half
            .corrected
            .as_ref()
            .filter(|corrected| **corrected != half.after)
        {
            line(&mut text, row("with their corrections", corrected));
        }
    }
    subset(
        &mut text,
        WITHOUT_OUTLIERS,
        report.verify_without_outliers.as_ref(),
    );
    line(&mut text, format!("evidence: {}", evidence(report)));
    text
}

fn identified(report: &Report) -> String {
    let mut text = String::new();
    let model = if report.model == Model::Paper {
        "paper"
    } else {
        "complete"
    };
    line(
        &mut text,
        format!(
            "{} on the {model} model: {}",
            name(report.method),
            report.method_reason
        ),
    );
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
    line(&mut text, columns());
    subset(&mut text, "identify", Some(&report.identify));
    subset(&mut text, "verify", report.verify.as_ref());
    subset(
        &mut text,
        WITHOUT_OUTLIERS,
        report.verify_without_outliers.as_ref(),
    );
    if let Some(last) = &report.final_fit {
        let (n, rms) = (last.n_points, error(last.rms_mm));
        let moved = error(last.moved_mm);
        line(
            &mut text,
            format!(
                "delivered: fitted to all {n} points ({rms} mm rms there), {moved} mm on average from the verified fit over the workspace"
            ),
        );
    }
    line(&mut text, format!("evidence: {}", evidence(report)));
    if let Some(tool) = report.tool_uncertainty_mm {
        let (mean, max) = (number(tool.mean), number(tool.max));
        line(
            &mut text,
            format!(
                "uncertainty of the tool's position with the links only: {mean} mm on average over the workspace, {max} mm at most (one standard \
                 deviation); it does not cover the corrections"
            ),
        );
    }
    if let Some(why) = &report.tool_uncertainty_absent_because {
        line(&mut text, format!("no uncertainty is stated: {why}"));
    }
    if let Some(std_deg) = report.flange_rotation_std_deg {
        let std_deg = number(std_deg);
        let last_zero = report
            .last_joint_zero_std_deg
            .map_or(String::new(), |zero| {
                format!(
                    "; {}° of it is the zero of the last joint, which positions never show",
                    number(zero)
                )
            });
        line(
            &mut text,
            format!(
                "uncertainty of the flange's rotation: {std_deg}° (one standard deviation, with general priors for robots{last_zero})"
            ),
        );
    }
    comparison(&mut text, &report.comparison);
    parameters(&mut text, &report.parameters);
    corrections(&mut text, report.corrections.as_deref().unwrap_or_default());
    text
}

fn evidence(report: &Report) -> String {
    match report.evidence {
        Evidence::None => format!("none; {}", why_no_evidence(report)),
        Evidence::SameUpload => format!("same upload; {}", why_same_upload(report)),
        Evidence::IndependentSession => "independent session; the strongest evidence".into(),
    }
}

fn line(text: &mut String, line: String) {
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{line}");
}

/// Label of the errors without the outliers that a warning names.
const WITHOUT_OUTLIERS: &str = "without outliers";

fn subset(text: &mut String, name: &str, half: Option<&SubsetReport>) {
    let Some(half) = half.filter(|half| half.n_points > 0) else {
        return;
    };
    line(
        text,
        row(&format!("{name} ({}), before", half.n_points), &half.before),
    );
    line(
        text,
        row(&format!("{name} ({}), after", half.n_points), &half.after),
    );
    if let Some(corrected) = half
        .corrected
        .as_ref()
        .filter(|corrected| **corrected != half.after)
    {
        line(
            text,
            row(&format!("{name} ({}), corrected", half.n_points), corrected),
        );
    }
    if let Some(rotation) = &half.rotation {
        let (before, after) = (rotation.before.rms_deg, rotation.after.rms_deg);
        line(
            text,
            format!("{name}, rotation: rms {before:.4}° before, {after:.4}° after"),
        );
    }
}

fn columns() -> String {
    format!(
        "{:<24}{:>10}{:>10}{:>10}{:>10}",
        "position error, mm", "mean", "std", "rms", "max"
    )
}

fn row(name: &str, e: &ErrorsReport) -> String {
    format!(
        "{name:<24}{:>10}{:>10}{:>10}{:>10}",
        error(e.mean_mm),
        error(e.std_mm),
        error(e.rms_mm),
        error(e.max_mm)
    )
}

fn comparison(text: &mut String, rows: &[ComparisonReport]) {
    line(
        text,
        format!(
            "\n{:<24}{:>12}{:>14}{:>12}{:>18}",
            "on the same points", "iterations", "F, mm²", "time, ms", "verify rms, mm"
        ),
    );
    for row in rows {
        let rms = row.verify_after.map_or("–".into(), |e| error(e.rms_mm));
        line(
            text,
            format!(
                "{:<24}{:>12}{:>14}{:>12.1}{rms:>18}",
                row.method,
                row.n_iterations,
                number(row.cost_mm2),
                row.duration_ms
            ),
        );
    }
}

fn parameters(text: &mut String, rows: &[ParameterReport]) {
    line(
        text,
        format!(
            "\n{:<16}{:>5}{:>14}{:>14}{:>12}{:>12}",
            "parameter", "unit", "nominal", "identified", "delta", "± std"
        ),
    );
    for row in rows {
        let std = match (row.identifiable, row.std_uncertainty) {
            (false, _) => "not seen".into(),
            (true, Some(std)) => number(std),
            (true, None) => "–".into(),
        };
        line(
            text,
            format!(
                "{:<16}{:>5}{:>14.5}{:>14.5}{:>12.5}{std:>12}",
                row.name, row.unit, row.nominal, row.identified, row.delta
            ),
        );
    }
}

fn corrections(text: &mut String, rows: &[CorrectionReport]) {
    if rows.is_empty() {
        return;
    }
    let head = [
        "rms without",
        "rms with",
        "gain, mm²",
        "± std error",
        "kept",
    ];
    line(
        text,
        format!(
            "\n{:<28}{:>12}{:>12}{:>12}{:>13}{:>6}",
            "corrections beyond the links, mm", head[0], head[1], head[2], head[3], head[4]
        ),
    );
    for row in rows {
        let errors = [
            row.cross_validated_rms_mm_before,
            row.cross_validated_rms_mm_after,
        ]
        .map(error);
        let gains = [row.gain_mm2, row.standard_error_mm2].map(number);
        let kept = if row.kept { "yes" } else { "no" };
        let why = row
            .dropped_because
            .as_ref()
            .map_or("", |_| "  (dropped: worse on the verify points)");
        let name = words::correction(&row.kind);
        line(
            text,
            format!(
                "{name:<28}{:>12}{:>12}{:>12}{:>13}{kept:>6}{why}",
                errors[0], errors[1], gains[0], gains[1]
            ),
        );
    }
}

/// The sessions that were fitted together, each with its errors.
fn pooled(text: &mut String, found: Option<&PooledReport>) {
    let Some(found) = found else { return };
    line(
        text,
        format!(
            "\n{} sessions were fitted together: sessions of an unchanged robot differ as much with probability {:.2}",
            found.sessions.len(),
            found.probability
        ),
    );
    for (session, of) in (1..).zip(&found.sessions) {
        let errors = [
            ("identified", of.identify_rms_mm),
            ("verified", of.verify_rms_mm),
        ];
        let errors = errors
            .iter()
            .filter_map(|(what, rms_mm)| Some(format!(", {} mm rms {what}", error((*rms_mm)?))));
        line(
            text,
            format!(
                "  session {session}: {} points from row {}{}",
                of.n_points,
                of.first_row,
                errors.collect::<String>()
            ),
        );
    }
}

fn repeatability(text: &mut String, found: Option<&RepeatabilityReport>) {
    let Some(found) = found else { return };
    let (rp, std) = (error(found.rp_mm), error(found.std_mm));
    line(
        text,
        format!(
            "\nrepeatability: RP {rp} mm over {} poses with {} points, {std} mm in one coordinate",
            found.n_poses, found.n_points
        ),
    );
}

/// A position error, mm.
fn error(value: f64) -> String {
    if (0.0..SMALLEST_MM).contains(&value) {
        format!("<{SMALLEST_MM}")
    } else {
        number(value)
    }
}

/// A number with about four significant digits, in scientific notation below 0.001.
pub fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if size < 1e-3 => format!("{value:.2e}"),
        size if size < 100.0 => format!("{value:.4}"),
        _ => format!("{value:.1}"),
    }
}

/// A method's name as in the API.
pub fn name(method: Method) -> &'static str {
    method.as_str()
}
