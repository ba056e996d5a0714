//! The section about sessions of other uploads and scored with the identified parameter set.

use super::sources::{ScoredSession, Sources};
use super::text::{error, time};
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
