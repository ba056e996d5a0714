//! The section about a quick check.

use super::text::{error, number, parameter, readable};
use super::words::{self, capital};
use crate::wire::report_shape::Report;
use crate::wire::report_shape::{CheckReport, CheckVerdict, DetectableReport};
use maud::{Markup, html};

/// The verdict, the changes that the poses can detect, and the next measurement. Empty for jobs of other kinds.
pub fn quick_check(report: &Report) -> Markup {
    html! { @if let Some(check) = &report.check { (section(check)) } }
}

fn section(check: &CheckReport) -> Markup {
    let verdict = match check.verdict {
        CheckVerdict::Holds => "The released set still holds.",
        CheckVerdict::Changed => "The released set no longer holds.",
        CheckVerdict::CannotTell => "These poses cannot tell whether the released set holds.",
    };
    html! {
        section {
            h2 { "Quick check" }
            p { strong { (verdict) } " " (capital(&readable(&check.reason))) "." }
            p { strong { "Next: " } (readable(&check.next)) "." }
            @if !check.detectable.is_empty() {
                p {
                    "The smallest change of each kind, alone, that these poses find in " (number(100.0 * check.power)) " of 100 cases. One of "
                    (number(1.0 / check.level)) " unchanged robots is called changed."
                }
                table {
                    thead { tr { th { "What" } th { "Smallest change" } th { "Moves the tool by, mm" } } }
                    tbody { @for row in &check.detectable { (line(row)) } }
                }
            }
        }
    }
}

fn line(row: &DetectableReport) -> Markup {
    let unit = if row.unit == "deg" { "°" } else { " mm" };
    html! {
        tr {
            td { (words::capital(&parameter(&row.name))) }
            @match (row.change, row.tool_mm) {
                (Some(change), Some(tool_mm)) => { td { (number(change)) (unit) } td { (error(tool_mm)) } },
                _ => { td { "not seen by these poses" } td {} },
            }
        }
    }
}
