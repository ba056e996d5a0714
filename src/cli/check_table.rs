//! The answer of a quick check, for a terminal.

use super::terminal::plain;
use crate::calibration::CheckVerdict;
use crate::wire::check::{CheckReport, DetectableReport};

/// Verdict, next step, and the smallest changes that these poses detect.
pub fn quick_check(check: &CheckReport) -> String {
    let verdict = match check.verdict {
        CheckVerdict::Holds => "the released set still holds",
        CheckVerdict::Changed => "CHANGED: the released set no longer holds",
        CheckVerdict::CannotTell => "these poses cannot tell whether the released set holds",
    };
    let mut text = format!("\ncheck: {verdict}\nnext: {}\n", plain(&check.next));
    if !check.detectable.is_empty() {
        text += &format!(
            "smallest change that is found in {:.0} of 100 cases (1 of {:.0} unchanged robots is called changed):\n",
            100.0 * check.power,
            1.0 / check.level
        );
    }
    check.detectable.iter().for_each(|row| text += &line(row));
    text
}

fn line(row: &DetectableReport) -> String {
    let unit = if row.unit == "deg" { "°" } else { " mm" };
    match (row.change, row.tool_mm) {
        (Some(change), Some(tool_mm)) => format!(
            "  {}: {change:.4}{unit}, moves the tool by {tool_mm:.3} mm\n",
            row.name
        ),
        _ => format!("  {}: not seen by these poses\n", row.name),
    }
}
