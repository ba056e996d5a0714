//! The report as a page to print or to file: one HTML text with everything in it, and nothing in it that asks for anything else.
//!
//! A pure function from the wire's shapes. Every text goes through maud's escaping; the style is the only thing that is not, and its
//! hash is in the page's policy, so that no name can become markup, a script or a request.

mod axes;
mod figures;
mod sections;
mod text;

use crate::wire::job::{JobAnswer, Kind};
use crate::wire::measurement::{Frame, SetSummary};
use crate::wire::parameter_set::ParameterSetAnswer;
use crate::wire::report_shape::{Convergence, Report};
use crate::wire::robot::RobotBody;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

const STYLE: &str = include_str!("style.css");

/// What the page may do: show itself, with this one style. Sent as a header, and in the page for whoever has it as a file.
pub static CONTENT_SECURITY_POLICY: LazyLock<String> = LazyLock::new(|| {
    let hash = BASE64_STANDARD.encode(Sha256::digest(STYLE.as_bytes()));
    format!("default-src 'none'; style-src 'sha256-{hash}'; base-uri 'none'; form-action 'none'")
});

/// What was measured.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredSet<'a> {
    /// What people call it.
    pub name: Option<&'a str>,
    /// The frame of every position.
    pub frame: Frame,
    /// Number of points.
    pub n_points: usize,
    /// Number of distinct arm configurations.
    pub n_configurations: usize,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: &'a str,
}

impl<'a> From<&'a SetSummary> for MeasuredSet<'a> {
    fn from(set: &'a SetSummary) -> Self {
        Self {
            name: set.name.as_deref(),
            frame: set.frame,
            n_points: set.n_points,
            n_configurations: set.n_configurations,
            sha256: &set.sha256,
        }
    }
}

/// What the page is made from.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    /// The robot.
    pub robot: &'a RobotBody,
    /// The set that it was identified from.
    pub set: MeasuredSet<'a>,
    /// The job; none offline.
    pub job: Option<&'a JobAnswer>,
    /// What was identified, as it stands now; none offline, and where nothing was identified.
    pub parameter_set: Option<&'a ParameterSetAnswer>,
    /// The report.
    pub report: &'a Report,
    /// How the cost fell.
    pub convergence: &'a Convergence,
}

impl Sources<'_> {
    /// True where a parameter set was only scored.
    fn is_verification(&self) -> bool {
        self.job.is_some_and(|job| job.kind == Kind::Verify)
    }

    /// Of which parameters a verification speaks.
    fn verified(&self) -> String {
        match &self.report.parameter_set_from {
            Some(id) => format!("parameter set {id}"),
            None => "the nominal robot".into(),
        }
    }

    /// Serial number and id of the robot, as far as there are any.
    fn which_robot(&self) -> Option<String> {
        let serial_number = self
            .robot
            .serial_number
            .as_ref()
            .map(|number| format!("serial number {number}"));
        let known: Vec<String> = serial_number
            .into_iter()
            .chain(self.job.map(|job| format!("robot {}", job.robot_id)))
            .collect();
        (!known.is_empty()).then(|| known.join(" · "))
    }

    /// What the page is called.
    fn title(&self) -> String {
        let what = if self.is_verification() {
            "Verification"
        } else {
            "Calibration"
        };
        format!("{what} of {}", self.robot.name)
    }
}

/// The page.
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
            body { (body(sources)) }
        }
    };
    page.into_string()
}

fn body(sources: &Sources<'_>) -> Markup {
    let report = sources.report;
    html! {
        header {
            p.kind { "kincal · calibration report" }
            h1 { (sources.title()) }
            @if let Some(which) = sources.which_robot() { p.under { (which) } }
        }
        main {
            (sections::verdict(sources))
            (sections::warnings(&report.warnings))
            (sections::facts(sources))
            (sections::errors(sources))
            (figures::per_point(&report.per_point))
            (figures::histogram(&report.per_point))
            (figures::convergence(sources.convergence))
            (figures::positions(&report.per_point))
            (sections::parameters(report))
            (sections::priors(report))
            (sections::corrections(report))
            (sections::repeatability(report))
            (sections::changes(report))
            (sections::comparison(report))
            (sections::origin(sources))
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
