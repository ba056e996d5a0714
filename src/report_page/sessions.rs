//! The sections about several sessions: those that were fitted together, and those that were scored with the identified parameter set.

use super::sources::{ScoredSession, Sources};
use super::text::{error, number, time};
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
                p.note { "The set was scored on points that were measured at another time. No link parameter was fitted to them; errors are rms, mm." }
                table {
                    thead { tr { th { "Scored" } th { "Job" } th.n { "Points" } th.n { "Nominal robot" } th.n { "This set" } th { "What it shows" } } }
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

fn row(session: &ScoredSession) -> Markup {
    let found = &session.found;
    let mm = |rms_mm: Option<f64>| rms_mm.map_or("–".into(), error);
    let interval = found
        .after_expanded_mm
        .map_or(String::new(), |expanded| format!(" ± {}", error(expanded)));
    let shows = match (found.fit, found.evidence) {
        (Fit::DoesNotFit, _) => "the file does not fit this robot",
        (Fit::SetFarOff, _) => "the set is far off: the robot has changed, or the set is wrong",
        (Fit::Fits, _) if !found.is_better => "no better than the nominal robot",
        (Fit::Fits, _) if found.is_worse => "several times worse than at the identification",
        (Fit::Fits, Evidence::IndependentSession) => "the set holds: independent session",
        (Fit::Fits, Evidence::SameUpload) => "limited evidence: its job says why",
        (Fit::Fits, Evidence::None) => "no evidence: its job says why",
    };
    html! {
        tr {
            td { (time(&session.scored_at)) } td { (session.job_id) } td.n { (found.n_points) }
            td.n { (mm(found.before_rms_mm)) } td.n { (mm(found.after_rms_mm)) (interval) } td { (shows) }
        }
    }
}
