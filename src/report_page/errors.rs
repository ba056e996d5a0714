//! Tables of the position errors.

use super::Sources;
use super::quality::fitted_points;
use super::text::error;
use crate::wire::report_shape::{ErrorsReport, Report, SubsetReport};
use maud::{Markup, html};

/// The errors before and after the calibration, on the identify and the verify points.
pub fn errors(sources: &Sources<'_>) -> Markup {
    let report = sources.report;
    if sources.is_verification() {
        return verified_errors(report);
    }
    let halves = [
        ("Identify", Some(&report.identify)),
        ("Verify", report.verify.as_ref()),
        (WITHOUT_OUTLIERS, report.verify_without_outliers.as_ref()),
    ];
    html! {
        section {
            h2 { "Position errors before and after, mm" }
            table {
                thead { tr { th { "points" } th { "robot" } th.n { "mean" } th.n { "std" } th.n { "rms" } th.n { "max" } } }
                tbody { @for (name, half) in halves { @if let Some(half) = half.filter(|half| half.n_points > 0) { (half_rows(name, half)) } } }
            }
            p.note { "Identify: the points of the fit. Verify: points kept aside. Before: " (sources.before()) "." }
            @if let Some(last) = &report.final_fit {
                p.note {
                    "The delivered parameters were then fitted " (fitted_points(last.n_points, sources.sets().map(|set| set.n_points).sum(), &report.per_point))
                    ", with " (error(last.rms_mm)) " mm rms there: the tool is " (error(last.moved_mm)) " mm on average from where the verified fit has it, over the workspace."
                }
            }
        }
    }
}

/// Label for the errors without the points that a warning lists as outliers.
const WITHOUT_OUTLIERS: &str = "Verify, without outliers";

/// The errors of the nominal robot and of the verified parameters, on all points.
fn verified_errors(report: &Report) -> Markup {
    let Some(half) = &report.verify else {
        return html! {};
    };
    let is_another = half.after != half.before;
    let mut rows = vec![("nominal robot", &half.before)];
    rows.extend(is_another.then_some(("these parameters", &half.after)));
    rows.extend(
        half.corrected
            .as_ref()
            .filter(|corrected| **corrected != half.after)
            .map(|e| ("these parameters, with corrections", e)),
    );
    let without = report.verify_without_outliers.as_ref();
    if let Some(without) = without {
        rows.push(("nominal robot, without outliers", &without.before));
        let after = without.corrected.as_ref().unwrap_or(&without.after);
        rows.extend(is_another.then_some(("these parameters, without outliers", after)));
    }
    html! {
        section {
            h2 { "Position errors of the nominal robot" @if is_another { " and with these parameters" } ", mm" }
            table {
                thead { tr { th { "on " (half.n_points) " points" } th.n { "mean" } th.n { "std" } th.n { "rms" } th.n { "max" } } }
                tbody {
                    @for (name, e) in rows {
                        tr { td { (name) } @for value in [e.mean_mm, e.std_mm, e.rms_mm, e.max_mm] { td.n { (error(value)) } } }
                    }
                }
            }
            p.note {
                "Nothing was fitted to these points but, in the instrument's frame, where base and reflectors are."
                @if is_another { " Before: the nominal robot. After: with these parameters." }
            }
        }
    }
}

fn half_rows(name: &str, half: &SubsetReport) -> Markup {
    let row = |name: &str, stage: &str, e: &ErrorsReport| {
        html! { tr { td { (name) } td { (stage) } @for value in [e.mean_mm, e.std_mm, e.rms_mm, e.max_mm] { td.n { (error(value)) } } } }
    };
    html! {
        (row(&format!("{name} ({})", half.n_points), "before", &half.before))
        (row("", "after", &half.after))
        @if let Some(corrected) = half.corrected.as_ref().filter(|corrected| **corrected != half.after) { (row("", "after, with corrections", corrected)) }
        @if let Some(rotation) = &half.rotation {
            tr {
                td { (name) ", rotation, rms" } td { "before, after" }
                td.n colspan="4" { (format!("{:.4}°, {:.4}°", rotation.before.rms_deg, rotation.after.rms_deg)) }
            }
        }
    }
}
