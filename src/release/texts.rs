//! Phrases that the details of several gates share.

use crate::wire::verification::Verification;

/// Advice to a person who knows why a robot is in order.
pub const CHECKED: &str = "mark the robot as checked, with the reason why it is in order";

/// Text with the errors of the nominal robot and of the set.
pub fn errors_in_words(found: &Verification) -> String {
    let mm = |rms_mm: Option<f64>| rms_mm.map_or("unknown".into(), |rms| format!("{rms:.4} mm"));
    format!(
        "{} before, {} after",
        mm(found.before_rms_mm),
        mm(found.after_rms_mm)
    )
}

/// Text with a number of sessions.
pub fn sessions(n: usize) -> String {
    match n {
        1 => "1 session".into(),
        n => format!("{n} sessions"),
    }
}
