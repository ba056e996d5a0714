//! The report as an HTML page for printing. The page is self-contained and loads no other resources.
//!
//! The page is a pure function of types in `wire`. maud escapes every text except the style sheet, whose hash is in the content security policy of
//! the page. So no name can become markup, a script or a request.

mod axes;
mod check;
mod conformity;
mod errors;
mod figures;
mod load;
mod quality;
mod sections;
mod sessions;
mod sources;
mod text;
pub mod words;

pub use sources::{MeasuredSet, ScoredSession, Sources};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

const STYLE: &str = include_str!("style.css");

/// Content security policy: allows only this style sheet. It is sent as an HTTP header. It is also in the page itself, for copies that are saved as
/// files.
pub static CONTENT_SECURITY_POLICY: LazyLock<String> = LazyLock::new(|| {
    let hash = BASE64_STANDARD.encode(Sha256::digest(STYLE.as_bytes()));
    format!("default-src 'none'; style-src 'sha256-{hash}'; base-uri 'none'; form-action 'none'")
});

/// Renders the page.
pub fn html(sources: &Sources<'_>) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(*CONTENT_SECURITY_POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (sources.title()) }
                style { (PreEscaped(STYLE)) }
            }
            body.of-withdrawn[conformity::is_withdrawn(sources)] { (body(sources)) }
        }
    };
    page.into_string()
}

fn body(sources: &Sources<'_>) -> Markup {
    let report = sources.report;
    html! {
        (conformity::withdrawn(sources))
        header {
            p.kind { "kincal · calibration report" }
            h1 { (sources.title()) }
            @if let Some(which) = sources.which_robot() { p.under { (which) } }
        }
        main {
            (conformity::verdict(sources))
            (sections::verdict(sources))
            @if let Some(rows) = load::left_out(sources) { p.note { "Left out of the measured file by hand: " (rows) } }
            (check::quick_check(report))
            (sections::warnings(&report.warnings))
            (sessions::fitted_together(sources))
            (sessions::sessions(sources))
            (sections::facts(sources))
            (quality::statement(sources))
            (errors::errors(sources))
            (figures::per_point(&report.per_point, sources.before()))
            div.pair {
                (figures::histogram(&report.per_point, sources.before()))
                (figures::convergence(sources.convergence))
            }
            (figures::positions(&report.per_point, sources.before()))
            (sections::corrections(report))
            (sections::repeatability(report))
            (sections::changes(report))
            (sections::comparison(report))
            (sections::parameters(report))
            (sections::priors(report))
            (sections::origin(sources))
            (quality::signature(sources))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::STYLE;

    #[test]
    fn the_style_cannot_end_its_element_or_ask_for_anything() {
        for forbidden in ["</", "url(", "@import", "//"] {
            assert!(!STYLE.contains(forbidden), "style.css holds {forbidden}");
        }
    }
}
