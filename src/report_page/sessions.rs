//! The sections about several sessions: those that were fitted together, and those that were scored with the identified parameter set.

use super::sources::{ScoredSession, Sources};
use super::text::{error, number, time};
use crate::release::{SessionVerdict, why_no_evidence, why_same_upload};
use crate::wire::report_shape::Evidence;
use crate::wire::verification::Fit;
use maud::{Markup, html};

/// The sessions on which the set was scored after its identification, newest first. Empty without any.
pub fn sessions(sources: &Sources<'_>) -> Markup {
    let sessions = sources.sessions;
    html! {
        @if !sessions.is_empty() {
            section {
                h2 { "Verified on other sessions" }
                p.note { "The set was scored on points that were measured at another time, which is that of their upload where it does not state one. No link parameter was fitted to them; errors are rms, mm." }
                table {
                    thead { tr { th { "Measured, and the job" } th.n { "Points" } th.n { "Nominal robot" } th.n { "This set" } th { "What it shows" } } }
                    tbody { @for session in sessions { (row(session)) } }
                }
            }
        }
    }
}

/// The sessions that were fitted together, and the test whether they are one robot. Empty for a job of one set.
pub fn fitted_together(sources: &Sources<'_>) -> Markup {
    let Some(pooled) = &sources.report.pooled else {
        return html! {};
    };
    let mm = |value_mm: Option<f64>| value_mm.map_or("–".into(), error);
    html! {
        section {
            h2 { "Sessions that were fitted together" }
            p {
                "They are one robot in one state, as far as these points tell: of an unchanged robot, the two sessions that are least alike differ as much with probability "
                strong { (format!("{:.2}", pooled.probability)) } " (sum of squares " (number(pooled.chi_square)) " of " (pooled.n_combinations)
                " combinations of parameters that both see). Links are fitted to all of them; each has its own base, reflectors and noise. Errors are rms of the links alone, mm."
                @if !pooled.shared_targets.is_empty() {
                    " Reflectors that were not mounted anew between sessions, and have one place on the tool: " (pooled.shared_targets.join(", ")) "."
                }
            }
            table {
                thead { tr { th { "Session" } th.n { "Points" } th.n { "Rows from" } th.n { "Noise of a coordinate, mm" } th.n { "Identify" } th.n { "Verify" } } }
                tbody {
                    @for (session, set) in pooled.sessions.iter().zip(sources.sets()) {
                        tr {
                            th { (set.name.unwrap_or("without a name")) } td.n { (session.n_points) } td.n { (session.first_row) }
                            td.n { @if let Some(noise_mm) = session.noise_std_mm { (error(noise_mm)) } @else { "as the others" } }
                            td.n { (mm(session.identify_rms_mm)) } td.n { (mm(session.verify_rms_mm)) }
                        }
                    }
                }
            }
        }
    }
}

/// Strength of the verification now, with the reason. It is determined by the newest session that is evidence for or against the set; if
/// there is none, by the identification.
pub fn evidence(sources: &Sources<'_>) -> String {
    let report = sources.report;
    let verified = sources.sessions.iter().find_map(|scored| {
        let shows = scored.session.verdict(sources.tolerance_mm.is_some())?;
        Some((scored, shows))
    });
    let of_session = verified.map(|(scored, shows)| {
        let found = &scored.session.verification;
        let rms = found.after_rms_mm.map_or("–".into(), error);
        let (at, job) = (time(&scored.measured_at), &scored.session.job_id);
        (
            shows,
            format!(
                "session of {at} (job {job}): {rms} mm rms on {} points",
                found.n_points
            ),
        )
    });
    match of_session {
        Some((SessionVerdict::Supports, session)) => {
            format!("independent session, measured after the identification: {session}")
        }
        Some((SessionVerdict::SpeaksAgainst, session)) => {
            format!("a later session speaks against these parameters: {session}")
        }
        None => match report.evidence {
            Evidence::None => format!("none: {}", why_no_evidence(report)),
            Evidence::SameUpload => format!("same upload: {}", why_same_upload(report)),
            Evidence::IndependentSession => {
                "independent session: checked on points of another measuring session".into()
            }
        },
    }
}

fn row(scored: &ScoredSession) -> Markup {
    let found = &scored.session.verification;
    let mm = |rms_mm: Option<f64>| rms_mm.map_or("–".into(), error);
    let interval = found
        .after_expanded_mm
        .map_or(String::new(), |expanded| format!(" ± {}", error(expanded)));
    let shows = match (found.fit, found.evidence) {
        (Fit::DoesNotFit, _) => "the file does not fit this robot",
        (Fit::SetFarOff, _) => "the set is far off: the robot has changed, or the set is wrong",
        (Fit::Fits, _) if !found.is_better => "no better than the nominal robot",
        (Fit::Fits, _) if found.is_worse => "several times worse than at the identification",
        (Fit::Fits, Evidence::IndependentSession) if scored.session.is_outdated => {
            "no evidence for today: older than what showed last that the robot may have changed"
        }
        (Fit::Fits, Evidence::IndependentSession) => "the set holds: independent session",
        (Fit::Fits, Evidence::SameUpload) => "limited evidence: its job says why",
        (Fit::Fits, Evidence::None) => "no evidence: its job says why",
    };
    html! {
        tr {
            td { (time(&scored.measured_at)) span.id { (scored.session.job_id) } } td.n { (found.n_points) }
            td.n { (mm(found.before_rms_mm)) } td.n { (mm(found.after_rms_mm)) (interval) } td { (shows) }
        }
    }
}
