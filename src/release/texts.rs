//! Phrases that the details of several gates share.

use crate::release::gate_facts::Facts;
use crate::wire::verification::Verification;

/// The request with which somebody states why a robot is in order.
pub const CHECKED: &str = "POST /v1/robots/{robot_id}/checked";

/// The request that scores the set on another session.
pub fn verify_request(facts: &Facts<'_>) -> String {
    format!(
        "post a job of kind verify with parameter_set_id {}",
        facts.parameter_set_id
    )
}

/// Errors of the nominal robot and of the set, in words.
pub fn errors_in_words(found: &Verification) -> String {
    let mm = |rms_mm: Option<f64>| rms_mm.map_or("unknown".into(), |rms| format!("{rms:.4} mm"));
    format!(
        "{} before, {} after",
        mm(found.before_rms_mm),
        mm(found.after_rms_mm)
    )
}

/// A number of sessions, in words.
pub fn sessions(n: usize) -> String {
    match n {
        1 => "1 session".into(),
        n => format!("{n} sessions"),
    }
}
