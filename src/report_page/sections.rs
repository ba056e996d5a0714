//! The parts of the page that are text and tables.

use super::Sources;
use super::text::{error, evidence, number, sentence, signed, time, unit};
use crate::wire::measurement::{Frame, Warning};
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::report_shape::{ErrorsReport, Report, SubsetReport};
use maud::{Markup, html};

/// A reduction by less than this is none.
const NO_REDUCTION: f64 = 0.001;

/// What came out, in one sentence.
pub fn verdict(report: &Report) -> Markup {
    let half = report.verify.as_ref().unwrap_or(&report.identify);
    let (before, after) = (half.before.mean_mm, half.after.mean_mm);
    let share = 1.0 - after / before;
    let by = if share > 0.9995 { "more than 99.9".into() } else { format!("{:.1}", 100.0 * share) };
    html! {
        p.verdict {
            "On " (half.n_points) @if report.verify.is_some() { " points that were not fitted" } @else { " points of the fit itself" }
            @if share > NO_REDUCTION {
                ", the mean position error fell from " (error(before)) " mm to " strong { (error(after)) " mm" } ", by " (by) " %."
            } @else {
                ", the mean position error went from " (error(before)) " mm to " strong { (error(after)) " mm" } ": it did not get better."
            }
        }
    }
}

/// What one should know before using it.
pub fn warnings(warnings: &[Warning]) -> Markup {
    html! {
        @for warning in warnings {
            p.warning { strong { (sentence(&warning.code)) ": " } (warning.detail) "." }
        }
    }
}

fn fact(name: &str, value: &str) -> Markup {
    html! { div { dt { (name) } dd { (value) } } }
}

/// What was measured, and how it was identified.
pub fn facts(sources: &Sources<'_>) -> Markup {
    let Sources { set, report, .. } = sources;
    let frame = if set.frame == Frame::Base { "robot base" } else { "instrument" };
    let name = set.name.unwrap_or("without a name");
    let set_text = format!("{name}: {} points in {} configurations, {frame} frame", set.n_points, set.n_configurations);
    let seen = &report.identifiability;
    html! {
        dl.facts {
            (fact("Measurement set", &set_text))
            (fact("Method", &format!("{}: {}", report.method.as_str(), report.method_reason)))
            @if seen.n_parameters > 0 {
                (fact("Model", &format!("{}: {} of {} parameters identified", report.model.as_str(), seen.rank, seen.n_parameters)))
            }
            (fact("Evidence", evidence(report.evidence)))
            @if let Some(tool) = report.tool_uncertainty_mm {
                (fact("Uncertainty of the tool", &format!("{} mm on average, {} mm at worst over the workspace (one standard deviation)", number(tool.mean), number(tool.max))))
            }
            @if let Some(error_model) = report.error_model {
                (fact("Scatter of the points", &format!("{} mm (one standard deviation of a coordinate)", number(error_model.noise_std_mm))))
            }
            @if let Some(set) = sources.parameter_set { (fact("Parameter set", &standing(set))) }
            @if let Some(finished_at) = sources.job.and_then(|job| job.finished_at.as_deref()) { (fact("Finished", &time(finished_at))) }
        }
    }
}

fn standing(set: &ParameterSetAnswer) -> String {
    match &set.released_at {
        Some(at) => format!("{}, released {}", set.status.as_str(), time(at)),
        None => set.status.as_str().into(),
    }
}

/// The errors before and after, on both halves.
pub fn errors(report: &Report) -> Markup {
    let halves = [("Identify", Some(&report.identify)), ("Verify", report.verify.as_ref())];
    html! {
        section {
            h2 { "Position errors before and after, mm" }
            table {
                thead { tr { th { "points" } th { "robot" } th.n { "mean" } th.n { "std" } th.n { "rms" } th.n { "max" } } }
                tbody { @for (name, half) in halves { @if let Some(half) = half { (half_rows(name, half)) } } }
            }
            p.note { "Identify: the points of the fit. Verify: points kept aside. Before: the nominal robot." }
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
    }
}

/// Every free parameter, and what the data could not see.
pub fn parameters(report: &Report) -> Markup {
    if report.parameters.is_empty() {
        return html! {};
    }
    let groups = &report.identifiability.unidentifiable;
    html! {
        section {
            h2 { "Parameters" }
            table {
                thead { tr { th { "parameter" } th { "unit" } th.n { "nominal" } th.n { "identified" } th.n { "change" } th.n { "± std" } th.n { "95 % interval" } } }
                tbody {
                    @for p in &report.parameters {
                        tr.unseen[!p.identifiable] {
                            th { (p.name) @if !p.identifiable { " *" } }
                            td { (unit(&p.unit)) }
                            td.n { (signed(p.nominal, 4)) }
                            td.n { (signed(p.identified, 4)) }
                            td.n { (signed(p.delta, 4)) }
                            @if p.identifiable {
                                td.n { (p.std_uncertainty.map_or("–".into(), number)) }
                                td.n { @if let Some([low, high]) = p.interval_95 { (signed(low, 4)) " to " (signed(high, 4)) } @else { "–" } }
                            } @else {
                                td.n colspan="2" { "not seen alone" }
                            }
                        }
                    }
                }
            }
            @if !groups.is_empty() {
                p.note {
                    "* The data cannot see these alone, only the sum of each group's effects: "
                    @for (i, group) in groups.iter().enumerate() { @if i > 0 { "; " } (group.join(" with ")) }
                    ". The positions are right all the same."
                }
            }
        }
    }
}

/// The corrections that were tried.
pub fn corrections(report: &Report) -> Markup {
    let rows = report.corrections.as_deref().unwrap_or_default();
    if rows.is_empty() {
        return html! {};
    }
    html! {
        section {
            h2 { "What links cannot say" }
            table {
                thead { tr { th { "correction" } th { "kept" } th.n { "rms without, mm" } th.n { "rms with, mm" } } }
                tbody {
                    @for c in rows {
                        tr {
                            th { (sentence(&c.kind)) }
                            td { @if c.kept { "yes" } @else { "no" } }
                            td.n { (error(c.cross_validated_rms_mm_before)) }
                            td.n { (error(c.cross_validated_rms_mm_after)) }
                        }
                    }
                }
            }
            p.note { "Errors by cross-validation on the identify points; a correction is kept only where it lowers them." }
        }
    }
}

/// What moved since the session before.
pub fn changes(report: &Report) -> Markup {
    let Some(rows) = &report.changed else { return html! {} };
    html! {
        section {
            h2 { "Moved since the session before" }
            @if rows.is_empty() {
                p { "Nothing beyond chance." }
            } @else {
                table {
                    thead { tr { th { "parameter" } th.n { "change, mm or °" } th.n { "in units of its uncertainty" } } }
                    tbody { @for c in rows { tr { th { (c.name) } td.n { (signed(c.delta, 5)) } td.n { (number(c.sigmas)) } } } }
                }
            }
        }
    }
}

/// Other methods on the same points.
pub fn comparison(report: &Report) -> Markup {
    if report.comparison.is_empty() {
        return html! {};
    }
    let own = report.method.as_str();
    let verify = |e: Option<&ErrorsReport>| e.map_or("–".into(), |e| error(e.rms_mm));
    html! {
        section {
            h2 { "Methods on the same points" }
            table {
                thead { tr { th { "method" } th.n { "iterations" } th.n { "evaluations" } th.n { "time, ms" } th.n { "F, mm²" } th.n { "verify rms, mm" } } }
                tbody {
                    tr {
                        th { "this result" }
                        td.n { (report.n_iterations) }
                        td.n { (report.n_evaluations) }
                        td.n { (format!("{:.0}", report.duration_ms)) }
                        td.n { (number(report.cost_mm2)) }
                        td.n { (verify(report.verify.as_ref().map(|half| &half.after))) }
                    }
                    @for row in &report.comparison {
                        tr {
                            th { (row.method) @if row.method == own { ", its search alone" } }
                            td.n { (row.n_iterations) }
                            td.n { (row.n_evaluations) }
                            td.n { (format!("{:.0}", row.duration_ms)) }
                            td.n { (number(row.cost_mm2)) }
                            td.n { (verify(row.verify_after.as_ref())) }
                        }
                    }
                }
            }
        }
    }
}

/// Identifiers, hashes and versions.
pub fn origin(sources: &Sources<'_>) -> Markup {
    let Sources { set, job, parameter_set, report, .. } = sources;
    html! {
        section {
            h2 { "Where it comes from" }
            dl.origin {
                @if let Some(job) = job { (fact("Job", &job.id)) (fact("Asked for", &time(&job.created_at))) }
                (fact("Computed by", &format!("kincal {}, preset {}, seed {}, ended by {}", report.version, report.preset.as_str(), report.seed, report.termination)))
                (fact("Measured file, SHA-256", set.sha256))
                @if let Some(set) = parameter_set { (fact("Parameter set", &set.id)) (fact("Parameters, SHA-256", &set.sha256)) }
                (fact("Result, SHA-256", &report.result_sha256))
            }
            p.note { "Equal result hashes mean equal results: the same request and seed on the same version give the same bits." }
        }
    }
}
