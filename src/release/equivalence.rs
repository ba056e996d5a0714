//! Whether a parameter set is equivalent to another one that was withdrawn.

use crate::wire::parameter_set::ParameterSetStatus;
use serde_json::Value;

/// Largest difference of two equal numbers: mm, degrees, or elements of rotation matrices. Identifying the same upload again with another
/// seed changes the numbers by 1e-12.
const TOLERANCE: f64 = 1e-6;

/// Two sets of the same points are equivalent if their tool positions differ by at most this share of the set's error on its verify points.
const SAME_TOOL: f64 = 0.1;

/// Whether a set is compared with the withdrawn sets of its robot: if it becomes the active set. A rollback may return to a set with the values of a
/// withdrawn one, and the set that is then active stays releasable.
pub fn is_compared_with_withdrawn(status: ParameterSetStatus, is_rollback: bool) -> bool {
    let becomes_active = matches!(
        status,
        ParameterSetStatus::Candidate | ParameterSetStatus::Superseded
    );
    becomes_active && !is_rollback
}

/// Whether a set is equivalent to another one: it has the same values, or it was identified from the same points and places the tool equally.
/// `verified_rms_mm` is its error on its verify points. The mean difference of the tool is computed only if it decides.
pub fn is_equivalent(
    own: &Value,
    verified_rms_mm: Option<f64>,
    other: &Value,
    is_of_same_points: bool,
    tool_difference_mm: impl FnOnce() -> Option<f64>,
) -> bool {
    let same_mm = SAME_TOOL * verified_rms_mm.unwrap_or(0.0);
    let is_same_tool = || tool_difference_mm().is_some_and(|mm| mm <= same_mm);
    has_same_values(own, other) || (is_of_same_points && is_same_tool())
}

/// Whether two documents of parameter sets have the same parameters, up to rounding.
fn has_same_values(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => (a - b).abs() <= TOLERANCE,
            _ => a == b,
        },
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| has_same_values(a, b))
        }
        (Value::Object(a), Value::Object(b)) => {
            let in_b = |(name, value)| b.get(name).is_some_and(|b| has_same_values(value, b));
            a.len() == b.len() && a.iter().all(in_b)
        }
        _ => a == b,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_may_differ_by_rounding_and_nothing_else_may() {
        let set = json!({"links": [{"a_mm": 260.0}, {"a_mm": 680.0}], "frame": "base"});
        let is_same = |other: Value| {
            assert_eq!(has_same_values(&set, &other), has_same_values(&other, &set));
            has_same_values(&set, &other)
        };
        let of = |a_mm: f64| json!({"links": [{"a_mm": 260.0}, {"a_mm": a_mm}], "frame": "base"});
        assert!(is_same(of(680.000_000_1)));
        assert!(!is_same(of(680.000_01)));
        assert!(!is_same(
            json!({"links": [{"a_mm": 260.0}], "frame": "base"})
        ));
        let mut more = of(680.0);
        more["corrections"] = json!({});
        assert!(!is_same(more));
    }
}
