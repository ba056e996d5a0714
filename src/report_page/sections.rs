//! Text and tables of the page.

use super::Sources;
use super::sessions::evidence;
use super::text::{self, error, fixed, number, parameter, signed, time, unit};
use crate::release::headline;
use crate::report_page::words;
use crate::wire::measurement::{Frame, Warning};
use crate::wire::parameter_set::{ParameterSetAnswer, ParameterSetStatus};
use crate::wire::report_shape::{ErrorsReport, PriorReport, Report};
use maud::{Markup, html};

/// Smallest relative reduction of the error that is reported as an improvement.
const NO_REDUCTION: f64 = 0.001;
/// Maximum number of revisited poses in the table. The text above the table covers all of them.
const MAX_POSES: usize = 40;

/// The result in one sentence.
pub fn verdict(sources: &Sources<'_>) -> Markup {
    let report = sources.report;
    let half = report.verify.as_ref().unwrap_or(&report.identify);
    let (before, after) = (half.before.mean_mm, half.after.mean_mm);
    let share = 1.0 - after / before;
    let by = if share > 0.9995 {
        "more than 99.9".into()
    } else {
        format!("{:.1}", 100.0 * share)
    };
    if sources.is_verification() && half.after == half.before {
        let of = sources.verified();
        return html! { (no_use(report)) p.verdict { "On " (half.n_points) " points, the mean position error of " (of) " is " strong { (error(after)) " mm" } "." } };
    }
    let points = if report.verify.is_some() {
        " points that were not fitted"
    } else {
        " points of the fit itself"
    };
    if headline(report).is_some() {
        return html! {
            (no_use(report))
            p.verdict { "On " (half.n_points) (points) ", the mean position error is " (error(before)) " mm before and " (error(after)) " mm after." }
        };
    }
    html! {
        p.verdict {
            "On " (half.n_points) (points)
            @if share > NO_REDUCTION {
                ", the mean position error fell from " (error(before)) " mm to " strong { (error(after)) " mm" } ", by " (by) " %."
            } @else {
                ", the mean position error went from " (error(before)) " mm to " strong { (error(after)) " mm" } ": it did not get better."
            }
        }
    }
}

/// Reason why the result cannot be used, if there is one.
fn no_use(report: &Report) -> Markup {
    html! {
        @if let Some(code) = headline(report) { p.warning { strong { (words::no_use(code)) "." } } }
    }
}

/// Warnings about the result.
pub fn warnings(warnings: &[Warning]) -> Markup {
    html! {
        @for warning in warnings {
            div.warning {
                p {
                    strong { (words::warning(&warning.code)) ". " }
                    (words::advice(&warning.code, warnings).join(" "))
                }
                p.note { (words::capital(&text::readable(warning.detail.trim_end_matches('.')))) (warning.points_in_words()) "." }
            }
        }
    }
}

fn fact(name: &str, value: &str) -> Markup {
    html! { div { dt { (name) } dd { (value) } } }
}

/// Measurement set, method and settings.
pub fn facts(sources: &Sources<'_>) -> Markup {
    let report = sources.report;
    let seen = &report.identifiability;
    html! {
        dl.facts {
            @if sources.further_sets.is_empty() {
                (fact("Measurement set", &measured(sources)))
            } @else {
                (fact("Measurement sets", &measured(sources)))
            }
            @if sources.is_verification() {
                (fact("Verified", &format!("{}; {}", sources.verified(), report.method_reason)))
            } @else {
                (fact("Method", &format!("{}: {}", words::method(report.method.as_str()), report.method_reason)))
            }
            @if seen.n_parameters > 0 { (fact("Model", &model(report))) }
            (fact("Evidence", &evidence(sources)))
            @for (with, tool) in [("by the links alone", report.tool_uncertainty_mm), ("with corrections", report.tool_uncertainty_corrected_mm)] {
                @if let Some(tool) = tool {
                    (fact("Uncertainty of the tool", &format!("{} mm on average, {} mm at worst over the workspace (one standard deviation); {with}", number(tool.mean), number(tool.max))))
                }
            }
            @if let Some(why) = &report.tool_uncertainty_absent_because { (fact("Uncertainty", &format!("not stated: {why}"))) }
            @if let Some(std_deg) = report.flange_rotation_std_deg {
                (fact("Rotation of the flange", &format!("known to {}° (one standard deviation over the workspace, under what is known of robots beforehand{})", number(std_deg), last_joint_zero(report))))
            }
            @if let Some(error_model) = report.error_model {
                (fact("Scatter of the points", &format!("{} mm (one standard deviation of a coordinate)", number(error_model.noise_std_mm))))
            }
            @if let Some(set) = sources.parameter_set { (fact("Parameter set", &standing(set))) }
            @if let Some(finished_at) = sources.job.and_then(|job| job.finished_at.as_deref()) { (fact("Finished", &time(finished_at))) }
        }
    }
}

/// Text about the measurement set, or about all sets of several sessions.
fn measured(sources: &Sources<'_>) -> String {
    let set = &sources.set;
    let frame = if set.frame == Frame::Base {
        "robot base"
    } else {
        "instrument"
    };
    if sources.further_sets.is_empty() {
        return format!(
            "{}: {} points in {} configurations, {frame} frame",
            set.name.unwrap_or("without a name"),
            set.n_points,
            set.n_configurations
        );
    }
    let n_points: usize = sources.sets().map(|set| set.n_points).sum();
    let sets = sources.sets().map(|set| {
        let name = set.name.unwrap_or("without a name");
        format!("{name} ({} points)", set.n_points)
    });
    let sets: Vec<String> = sets.collect();
    format!(
        "{} sessions that were fitted together, {n_points} points, {frame} frame: {}",
        sets.len(),
        sets.join(", ")
    )
}

fn last_joint_zero(report: &Report) -> String {
    let Some(std_deg) = report.last_joint_zero_std_deg else {
        return String::new();
    };
    format!(
        "; {}° of it is the zero of the last joint, which positions never show",
        number(std_deg)
    )
}

/// The model and what the points determine. The rank is a number of parameter combinations; a parameter may be part of several combinations.
fn model(report: &Report) -> String {
    let seen = &report.identifiability;
    let n_alone = report
        .parameters
        .iter()
        .filter(|parameter| parameter.identifiable)
        .count();
    format!(
        "{}: {n_alone} of {} parameters alone, {} independent combinations",
        report.model.as_str(),
        seen.n_parameters,
        seen.rank
    )
}

fn standing(set: &ParameterSetAnswer) -> String {
    match &set.released_at {
        Some(at) if set.status == ParameterSetStatus::Released => format!("released {}", time(at)),
        Some(at) => format!("{}, released {}", set.status.as_str(), time(at)),
        None => set.status.as_str().into(),
    }
}

/// All free parameters, with a note about those that the data do not determine.
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
                            th { (parameter(&p.name)) @if !p.identifiable { " *" } }
                            td { (unit(&p.unit)) }
                            td.n { (fixed(p.nominal, 4)) @if p.link.is_none() { " (start)" } }
                            td.n { (fixed(p.identified, 4)) }
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
            @if !groups.is_empty() { p.note { "* " (unseen(groups)) } }
        }
    }
}

/// Parameters that the data determine only in combination with others, or not at all.
fn unseen(groups: &[Vec<String>]) -> String {
    let (single, several): (Vec<&Vec<String>>, Vec<&Vec<String>>) =
        groups.iter().partition(|group| group.len() == 1);
    let mut text = String::new();
    if !several.is_empty() {
        let several: Vec<String> = several
            .iter()
            .map(|group| in_words(group).join(" with "))
            .collect();
        text += &format!(
            "The data cannot see these alone, only the sum of each group's effects: {}. ",
            several.join("; ")
        );
    }
    if !single.is_empty() {
        let single: Vec<String> = single.iter().flat_map(|group| in_words(group)).collect();
        text += &format!("The data cannot see at all: {}. ", single.join(", "));
    }
    text + "The positions of the measured reflector are right all the same; of another tool they may not be."
}

fn in_words(names: &[String]) -> Vec<String> {
    names.iter().map(|name| parameter(name)).collect()
}

/// The priors of the request, and their share in the result.
pub fn priors(report: &Report) -> Markup {
    let known: Vec<_> = report
        .parameters
        .iter()
        .filter_map(|p| Some((p, p.prior.as_ref()?)))
        .collect();
    if known.is_empty() {
        return html! {};
    }
    html! {
        section {
            h2 { "Known beforehand" }
            table {
                thead { tr { th { "parameter" } th { "unit" } th.n { "expected" } th.n { "± std" } th.n { "allowed" } th.n { "share of what is known now" } } }
                tbody {
                    @for (parameter, prior) in known {
                        tr {
                            th { (text::parameter(&parameter.name)) }
                            td { (unit(&parameter.unit)) }
                            td.n { (signed(prior.mean, 4)) }
                            td.n { (number(prior.std)) }
                            td.n { (allowed(prior)) @if let Some(bound) = &prior.at_bound { ", ended at " (bound) } }
                            td.n { (prior.share.map_or("–".into(), |share| format!("{:.0} %", 100.0 * share))) }
                        }
                    }
                }
            }
            p.note { "The share is what comes from beforehand, not from the measured points: at 100 % the points say nothing." }
        }
    }
}

fn allowed(prior: &PriorReport) -> String {
    match (prior.min, prior.max) {
        (None, None) => "any".into(),
        (Some(min), None) => format!("from {}", signed(min, 4)),
        (None, Some(max)) => format!("to {}", signed(max, 4)),
        (Some(min), Some(max)) => format!("{} to {}", signed(min, 4), signed(max, 4)),
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
            h2 { "Corrections" }
            table {
                thead { tr { th { "correction" } th.n { "rms without, mm" } th.n { "rms with, mm" } th.n { "gain, mm²" } th.n { "± standard error" } th { "kept" } } }
                tbody {
                    @for c in rows {
                        tr {
                            th { (words::correction(&c.kind)) }
                            td.n { (error(c.cross_validated_rms_mm_before)) }
                            td.n { (error(c.cross_validated_rms_mm_after)) }
                            td.n { (number(c.gain_mm2)) }
                            td.n { (number(c.standard_error_mm2)) }
                            td { @if c.kept { strong { "yes" } } @else if c.dropped_because.is_some() { "dropped: worse on the verify points" } @else { "no" } }
                        }
                    }
                }
            }
            p.note {
                "By cross-validation on the identify points; the gain is what a configuration's mean squared error falls by. Kept where it is above "
                "twice its standard error. All are dropped where the points to verify are further from the "
                "robot with corrections than from its links alone."
            }
        }
    }
}

/// Repeatability of the robot.
pub fn repeatability(report: &Report) -> Markup {
    let Some(found) = &report.repeatability else {
        return html! {};
    };
    let corrected = found
        .poses
        .iter()
        .any(|pose| pose.ap_corrected_mm.is_some());
    html! {
        section {
            h2 { "Repeatability" }
            p {
                "RP " strong { (error(found.rp_mm)) " mm" } " over " (found.n_poses) " poses that were visited several times (" (found.n_points)
                " points); one coordinate scatters by " strong { (error(found.std_mm)) " mm" } " (one standard deviation)."
            }
            table {
                thead { tr {
                    th { "configuration" } th.n { "target" } th.n { "visits" } th.n { "RP, mm" } th.n { "AP before, mm" } th.n { "AP after, mm" }
                    @if corrected { th.n { "AP corrected, mm" } }
                } }
                tbody {
                    @for pose in found.poses.iter().take(MAX_POSES) {
                        tr {
                            th { (pose.name.as_ref().unwrap_or(&pose.configuration)) }
                            td.n { (pose.target) }
                            td.n { (pose.n) }
                            td.n { (error(pose.rp_mm)) }
                            td.n { (error(pose.ap_before_mm)) }
                            td.n { (error(pose.ap_after_mm)) }
                            @if corrected { td.n { (pose.ap_corrected_mm.map_or("–".into(), error)) } }
                        }
                    }
                }
            }
            p.note {
                @if found.poses.len() > MAX_POSES { "The first " (MAX_POSES) " of " (found.poses.len()) " poses. " }
                "As ISO 9283 has them: RP is the mean distance from the pose's barycentre and three standard deviations of it; AP goes from the "
                "barycentre to where the robot should be. The norm asks for 30 visits; with few, RP comes out too small."
            }
        }
    }
}

/// Changes since the previous session.
pub fn changes(report: &Report) -> Markup {
    let Some(rows) = &report.changed else {
        return html! {};
    };
    html! {
        section {
            h2 { "Moved since the session before" }
            @if rows.is_empty() {
                p { "Nothing beyond chance." }
            } @else {
                table {
                    thead { tr { th { "parameter" } th.n { "change, mm or °" } th.n { "in units of its uncertainty" } } }
                    tbody { @for c in rows { tr { th { (parameter(&c.name)) } td.n { (signed(c.delta, 5)) } td.n { (number(c.sigmas)) } } } }
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
                            th { (words::method(&row.method)) @if row.method == own { ", its search alone" } }
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
    let Sources {
        job,
        parameter_set,
        report,
        ..
    } = sources;
    let asked = match sources.is_verification() {
        true => String::new(),
        false => format!(
            ", preset {}, seed {}, ended by {}",
            report.preset.as_str(),
            report.seed,
            report.termination.replace('_', " ")
        ),
    };
    html! {
        section {
            h2 { "Where it comes from" }
            dl.origin {
                @if let Some(job) = job { (fact("Job", &job.id)) (fact("Asked for", &time(&job.created_at))) }
                (fact("Computed by", &format!("kincal {}{asked}", report.version)))
                @for set in sources.sets() { (fact("Measured file, SHA-256", set.sha256)) }
                @if sources.is_verification() { @if let Some(id) = &report.parameter_set_from { (fact("Verified parameter set", id)) } }
                @if let Some(set) = parameter_set { (fact("Parameter set", &set.id)) (fact("Parameters, SHA-256", &set.sha256)) }
                (fact("Result, SHA-256", &report.result_sha256))
            }
            p.note { "Equal result hashes mean equal results: the same request and seed on the same version give the same bits." }
        }
    }
}
