//! The sections for quality records: measurement equipment and persons, the frame and the tool that the values refer to, the verdict, and a
//! signature.

use super::Sources;
use super::load;
use super::text::{error, fixed, number, time};
use crate::wire::instrument::InstrumentBody;
use crate::wire::measurement::Frame;
use crate::wire::reference::ReferenceReport;
use crate::wire::report_shape::PointReport;
use crate::wire::session_record::SessionRecord;
use maud::{Markup, html};

/// Maximum number of outliers that are named.
const MAX_NAMED: usize = 4;

/// The frame and the tool that the values refer to, and the comparison with the tolerance.
pub fn statement(sources: &Sources<'_>) -> Markup {
    html! {
        section {
            h2 { "What the figures hold for" }
            dl.facts {
                div { dt { "Quantity" } dd { (quantity(sources)) } }
                div { dt { "Frame" } dd { (frame(sources)) } }
                @for record in sources.sets().filter_map(|set| set.record) { div { dt { "Measured" } dd { (measured(record)) } } }
                @for stated in sources.sets().filter_map(|set| set.instrument.as_ref()) { div { dt { "Instrument, as stated" } dd { (instrument(stated)) } } }
                @if let Some(found) = &sources.report.reference { div { dt { "Instrument, by its reference" } dd { (reference(found)) } } }
                div { dt { "Tool" } dd { (tool(sources)) } }
                div { dt { "Points" } dd { (points(sources)) } }
                div { dt { "Tolerance" } dd { (tolerance(sources)) } }
                div { dt { "Payload" } dd { (load::payload(sources)) } }
                div { dt { "Mounting" } dd { (load::mounting(sources)) } }
                @if let Some(rows) = load::left_out(sources) { div { dt { "Left out by hand" } dd { (rows) } } }
            }
        }
    }
}

fn quantity(sources: &Sources<'_>) -> &'static str {
    if sources.report.repeatability.is_some() {
        "distance of the measured from the commanded position at each pose. Positioning accuracy AP and repeatability RP of ISO 9283 are stated for the poses that were visited several times"
    } else {
        "distance of the measured from the commanded position at each pose, each visited once: the single-visit form of the positioning accuracy AP of ISO 9283. Repeatability RP was not measured"
    }
}

fn frame(sources: &Sources<'_>) -> &'static str {
    match sources.set.frame {
        Frame::Base => {
            "the robot's base frame, in which the positions were given: an error of that frame is part of the figures"
        }
        Frame::Instrument => {
            "the instrument's frame; the base was found with the parameters, so its placement is not part of the figures"
        }
    }
}

fn reference(found: &ReferenceReport) -> String {
    format!(
        "lengths {:+.1} ppm, standard uncertainty {:.1} ppm: {:.4} mm at the arm's reach, part of the uncertainty of the tool; positions are not corrected for it",
        found.scale_error_ppm, found.scale_std_ppm, found.at_reach_std_mm
    )
}

fn measured(record: &SessionRecord) -> String {
    let certificate = record.instrument_certificate.as_deref();
    let certificate = certificate.map_or(String::new(), |text| format!(", certificate {text}"));
    let instrument = record.instrument_name.as_deref();
    let instrument = instrument.map(|name| format!("with {name}{certificate}"));
    let of_points = match record.measured_at_of_points {
        true => " (the earliest time of its points)",
        false => "",
    };
    let at = record.measured_at.as_deref().map(time);
    let words = [
        at.map(|at| format!("{at}{of_points}")),
        record.operator.as_deref().map(|name| format!("by {name}")),
        instrument,
    ];
    let words: Vec<String> = words.into_iter().flatten().collect();
    words.join("; ")
}

fn instrument(stated: &InstrumentBody) -> String {
    let per_m = stated.range_std_mm_per_m.filter(|per_m| *per_m > 0.0);
    let per_m = per_m.map_or(String::new(), |per_m| format!(" + {per_m} mm per m"));
    let range = stated.range_std_mm;
    let range = range.map(|mm| format!("length {mm} mm{per_m} (one standard deviation)"));
    let angles = stated.angle_std_deg;
    let angles = angles.map(|deg| format!("angles {deg}° (one standard deviation)"));
    let levelled = match stated.levelled {
        Some(true) => Some("levelled: gravity is −z of its frame".into()),
        _ => None,
    };
    let words: Vec<String> = range.into_iter().chain(angles).chain(levelled).collect();
    words.join("; ")
}

fn tool(sources: &Sources<'_>) -> String {
    let targets = sources.parameter_set.map(|set| set.targets.as_slice());
    match targets {
        Some([]) => {
            "the measured reflector, whose place on the flange was given. Other tools may be off by more"
                .into()
        }
        Some(targets) => {
            let places: Vec<String> = targets
                .iter()
                .map(|target| {
                    let [x, y, z] = target.position_mm;
                    format!("{}, {}, {} mm", fixed(x, 2), fixed(y, 2), fixed(z, 2))
                })
                .collect();
            format!(
                "the measured reflector, at {} in the flange frame. Other tools may be off by more",
                places.join("; ")
            )
        }
        None => "the measured reflector. Other tools may be off by more".into(),
    }
}

fn points(sources: &Sources<'_>) -> String {
    let report = sources.report;
    let held = report.verify.as_ref().map_or(0, |half| half.n_points);
    let n_points: usize = sources.sets().map(|set| set.n_points).sum();
    let mut text = if sources.is_verification() {
        format!("{held} points were scored; no link was fitted to them")
    } else {
        format!(
            "fitted to {} points; judged on {held} points that were kept aside",
            report.identify.n_points
        )
    };
    if let Some(last) = &report.final_fit {
        text += &format!(
            "; the delivered parameters were then fitted {} ({} mm rms there, {} mm away on average)",
            fitted_points(last.n_points, n_points, &report.per_point),
            error(last.rms_mm),
            error(last.moved_mm)
        );
    }
    text
}

/// To how many of the points the delivered parameters were fitted, and which were left out as outliers.
pub fn fitted_points(n_fitted: usize, n_points: usize, points: &[PointReport]) -> String {
    if n_fitted == n_points {
        return format!("to all {n_fitted} points");
    }
    let own = points.iter().take(n_points);
    let outliers: Vec<&PointReport> = own.filter(|point| point.outlier).collect();
    if outliers.len() != n_points - n_fitted.min(n_points) {
        return format!("to {n_fitted} of {n_points} points");
    }
    let name = |point: &&PointReport| {
        let own_name = point.name.as_deref();
        own_name.unwrap_or(&point.configuration).to_owned()
    };
    let which = match outliers.len() {
        ..=MAX_NAMED => outliers.iter().map(name).collect::<Vec<_>>().join(", "),
        n => n.to_string(),
    };
    let kind = if outliers.len() == 1 {
        "an outlier"
    } else {
        "outliers"
    };
    format!("to {n_fitted} of {n_points} points ({which} left out as {kind})")
}

/// The decision at the release, by the policy at that time. Before a release: the comparison of the rms error alone, which decides nothing.
fn tolerance(sources: &Sources<'_>) -> Markup {
    let checks = sources
        .parameter_set
        .and_then(|set| set.release_checks.as_deref());
    let mut checks = checks.unwrap_or_default().iter();
    if let Some(gate) = checks.find(|gate| gate.gate == "verify_errors_within_tolerance") {
        return html! { "at the release: " strong { (gate.detail) } };
    }
    let Some(tolerance) = sources.tolerance_mm else {
        return html! { "none is stated in the robot's policy" };
    };
    let report = sources.report;
    let half = report.verify.as_ref().unwrap_or(&report.identify);
    let found = half.corrected.as_ref().unwrap_or(&half.after).rms_mm;
    html! {
        (number(tolerance)) " mm; the rms error alone, " (error(found)) " mm on " (half.n_points)
        @if report.verify.is_some() { " points that were not fitted" } @else { " points of the fit itself" }
        ", is " strong { @if found <= tolerance { "not above it" } @else { "above it" } }
        ". A release decides by the policy's rule, with the uncertainty"
    }
}

/// Fields to be filled in by hand for facts that the service does not know, and the signature of the responsible person.
pub fn signature(sources: &Sources<'_>) -> Markup {
    let released = sources.parameter_set.and_then(|set| {
        let id = set.released_by.as_deref()?;
        let by = match &set.released_by_name {
            Some(name) => format!("{name} ({id})"),
            None => id.to_owned(),
        };
        Some((by, set.release_reason.as_deref()?))
    });
    let record = sources.set.record.cloned().unwrap_or_default();
    let blanks = [
        (
            "Instrument, serial number",
            record.instrument_name.is_none(),
        ),
        (
            "Its certificate, valid until",
            record.instrument_certificate.is_none(),
        ),
        ("Operator", record.operator.is_none()),
        ("Place and date", true),
        ("Checked by, signature", true),
    ];
    html! {
        section.signature {
            h2 { "Responsibility" }
            @if let Some((by, reason)) = released { p.note { "Released with the key " (by) ": " (reason) } }
            div.blanks {
                @for (name, is_blank) in blanks { @if is_blank { div { (name) } } }
            }
        }
    }
}
