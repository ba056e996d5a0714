//! A report as text for a terminal.

use super::remedy::with_options;
use super::terminal::plain;
use crate::release::{headline, why_no_evidence, why_same_upload};
use crate::report_page::words;
use crate::wire::decimals::fixed;
use crate::wire::job::Model;
use crate::wire::report_shape::{
    CheckReport, CheckVerdict, ComparisonReport, CorrectionReport, DetectableReport, ErrorsReport,
    Evidence, ParameterReport, RepeatabilityReport, Report, SubsetReport,
};
use crate::wire::sessions::PooledReport;
use crate::wire::warning::Warning;
use std::fmt::Write;

/// Smallest error that is printed as a number, mm: no instrument resolves a tenth of a micrometre.
const SMALLEST_MM: f64 = 1e-4;

/// Adds a line to a text.
macro_rules! line {
    ($text:ident $(, $($said:tt)+)?) => {
        // Writing to a String cannot fail.
        let _ = writeln!($text $(, $($said)+)?);
    };
}

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
        line!(text, "\n{}", warning_in_words(warning));
        let advice = words::advice(&warning.code, &report.warnings);
        if !advice.is_empty() {
            line!(text, "  {}", advice.join(" "));
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
    line!(text, "{what}: {}", report.method_reason);
    if let Some(check) = &report.check {
        text.push_str(&quick_check(check));
    }
    columns(&mut text);
    if let Some(half) = &report.verify {
        let n = half.n_points;
        row(&mut text, &format!("nominal ({n})"), &half.before);
        if half.after != half.before {
            row(&mut text, &format!("these parameters ({n})"), &half.after);
        }
        if let Some(corrected) = corrected(half) {
            row(&mut text, "with their corrections", corrected);
        }
    }
    without_outliers(&mut text, report);
    line!(text, "evidence: {}", evidence(report));
    text
}

fn identified(report: &Report) -> String {
    let mut text = String::new();
    let model = if report.model == Model::Paper {
        "paper"
    } else {
        "complete"
    };
    line!(
        text,
        "{} on the {model} model: {}",
        report.method.as_str(),
        report.method_reason
    );
    line!(
        text,
        "{} iterations, F = {} mm², {:.0} ms, rank {} of {} parameters",
        report.n_iterations,
        number(report.cost_mm2),
        report.duration_ms,
        report.identifiability.rank,
        report.identifiability.n_parameters
    );
    columns(&mut text);
    subset(&mut text, "identify", Some(&report.identify));
    subset(&mut text, "verify", report.verify.as_ref());
    without_outliers(&mut text, report);
    if let Some(last) = &report.final_fit {
        let (n, rms) = (last.n_points, error(last.rms_mm));
        let moved = error(last.moved_mm);
        line!(
            text,
            "delivered: fitted to all {n} points ({rms} mm rms there), {moved} mm on average from the verified fit over the workspace"
        );
    }
    line!(text, "evidence: {}", evidence(report));
    let known = [
        ("the links alone", report.tool_uncertainty_mm),
        ("the corrections", report.tool_uncertainty_corrected_mm),
    ];
    for (with, tool) in known {
        let Some(tool) = tool else { continue };
        let (mean, max) = (number(tool.mean), number(tool.max));
        line!(
            text,
            "uncertainty of the tool's position with {with}: {mean} mm on average over the workspace, {max} mm at most (one standard deviation)"
        );
    }
    if let Some(why) = &report.tool_uncertainty_absent_because {
        line!(text, "no uncertainty is stated: {why}");
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
        line!(
            text,
            "uncertainty of the flange's rotation: {std_deg}° (one standard deviation, with general priors for robots{last_zero})"
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
        Evidence::IndependentSession if headline(report).is_some() => {
            "independent session; it speaks against the parameter set".into()
        }
        Evidence::IndependentSession => "independent session; the strongest evidence".into(),
    }
}

/// The errors without the outliers that a warning names.
fn without_outliers(text: &mut String, report: &Report) {
    let half = report.verify_without_outliers.as_ref();
    subset(text, "without outliers", half);
}

fn subset(text: &mut String, name: &str, half: Option<&SubsetReport>) {
    let Some(half) = half.filter(|half| half.n_points > 0) else {
        return;
    };
    let points = format!("{name} ({})", half.n_points);
    row(text, &format!("{points}, before"), &half.before);
    row(text, &format!("{points}, after"), &half.after);
    if let Some(corrected) = corrected(half) {
        row(text, &format!("{points}, corrected"), corrected);
    }
    if let Some(rotation) = &half.rotation {
        let (before, after) = (rotation.before.rms_deg, rotation.after.rms_deg);
        line!(
            text,
            "{name}, rotation: rms {before:.4}° before, {after:.4}° after"
        );
    }
}

/// The errors with corrections, if they differ from those without.
fn corrected(half: &SubsetReport) -> Option<&ErrorsReport> {
    half.corrected.as_ref().filter(|with| **with != half.after)
}

fn columns(text: &mut String) {
    line!(
        text,
        "\nposition error, mm            mean       std       rms       max"
    );
}

fn row(text: &mut String, name: &str, e: &ErrorsReport) {
    let [mean, std, rms, max] = [e.mean_mm, e.std_mm, e.rms_mm, e.max_mm].map(error);
    line!(text, "{name:<24}{mean:>10}{std:>10}{rms:>10}{max:>10}");
}

fn comparison(text: &mut String, rows: &[ComparisonReport]) {
    line!(
        text,
        "\non the same points        iterations        F, mm²    time, ms    verify rms, mm"
    );
    for row in rows {
        let rms = row.verify_after.map_or("–".into(), |e| error(e.rms_mm));
        line!(
            text,
            "{:<24}{:>12}{:>14}{:>12.1}{rms:>18}",
            row.method,
            row.n_iterations,
            number(row.cost_mm2),
            row.duration_ms
        );
    }
}

fn parameters(text: &mut String, rows: &[ParameterReport]) {
    line!(
        text,
        "\nparameter        unit       nominal    identified       delta       ± std"
    );
    for row in rows {
        let std = match (row.identifiable, row.std_uncertainty) {
            (false, _) => "not seen".into(),
            (true, Some(std)) => number(std),
            (true, None) => "–".into(),
        };
        line!(
            text,
            "{:<16}{:>5}{:>14}{:>14}{:>12}{std:>12}",
            row.name,
            row.unit,
            fixed(row.nominal, 5),
            fixed(row.identified, 5),
            fixed(row.delta, 5)
        );
    }
}

fn corrections(text: &mut String, rows: &[CorrectionReport]) {
    if rows.is_empty() {
        return;
    }
    line!(
        text,
        "\ncorrections beyond the links, mm rms without    rms with   gain, mm²  ± std error  kept"
    );
    for row in rows {
        let before = error(row.cross_validated_rms_mm_before);
        let after = error(row.cross_validated_rms_mm_after);
        let [gain, std] = [row.gain_mm2, row.standard_error_mm2].map(number);
        let kept = if row.kept { "yes" } else { "no" };
        let why = row
            .dropped_because
            .as_ref()
            .map_or("", |_| "  (dropped: worse on the verify points)");
        let name = words::correction(&row.kind);
        line!(
            text,
            "{name:<28}{before:>12}{after:>12}{gain:>12}{std:>13}{kept:>6}{why}"
        );
    }
}

/// The sessions that were fitted together, each with its errors.
fn pooled(text: &mut String, found: Option<&PooledReport>) {
    let Some(found) = found else { return };
    line!(
        text,
        "\n{} sessions were fitted together: sessions of an unchanged robot differ as much with probability {:.2}",
        found.sessions.len(),
        found.probability
    );
    for (session, of) in (1..).zip(&found.sessions) {
        let errors = [
            ("identified", of.identify_rms_mm),
            ("verified", of.verify_rms_mm),
        ];
        let errors = errors
            .iter()
            .filter_map(|(what, rms_mm)| Some(format!(", {} mm rms {what}", error((*rms_mm)?))));
        line!(
            text,
            "  session {session}: {} points from row {}{}",
            of.n_points,
            of.first_row,
            errors.collect::<String>()
        );
    }
}

fn repeatability(text: &mut String, found: Option<&RepeatabilityReport>) {
    let Some(found) = found else { return };
    let (rp, std) = (error(found.rp_mm), error(found.std_mm));
    line!(
        text,
        "\nrepeatability: RP {rp} mm over {} poses with {} points, {std} mm in one coordinate",
        found.n_poses,
        found.n_points
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

/// A warning in one line, with the names of its points.
pub fn warning_in_words(warning: &Warning) -> String {
    plain(&format!(
        "warning: {} ({}): {}{}",
        words::warning(&warning.code),
        warning.code,
        with_options(&warning.detail),
        warning.points_in_words()
    ))
}

/// Verdict, next step, and the smallest changes that these poses detect.
fn quick_check(check: &CheckReport) -> String {
    let verdict = match check.verdict {
        CheckVerdict::Holds => "the released set still holds",
        CheckVerdict::Changed => "CHANGED: the released set no longer holds",
        CheckVerdict::CannotTell => "these poses cannot tell whether the released set holds",
    };
    let mut text = format!("\ncheck: {verdict}\nnext: {}\n", plain(&check.next));
    if !check.detectable.is_empty() {
        text += &format!(
            "smallest change that is found in {:.0} of 100 cases (1 of {:.0} unchanged robots is called changed):\n",
            100.0 * check.power,
            1.0 / check.level
        );
    }
    check
        .detectable
        .iter()
        .for_each(|row| text += &detectable(row));
    text
}

fn detectable(row: &DetectableReport) -> String {
    let unit = if row.unit == "deg" { "°" } else { " mm" };
    match (row.change, row.tool_mm) {
        (Some(change), Some(tool_mm)) => format!(
            "  {}: {change:.4}{unit}, moves the tool by {tool_mm:.3} mm\n",
            row.name
        ),
        _ => format!("  {}: not seen by these poses\n", row.name),
    }
}
