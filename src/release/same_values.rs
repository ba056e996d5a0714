//! Whether two parameter sets have equal values.

use serde_json::Value;

/// Largest difference of two equal numbers: mm, degrees, or elements of rotation matrices. Identifying the same upload again with another
/// seed changes the numbers by 1e-12.
const TOLERANCE: f64 = 1e-6;

/// Whether two documents of parameter sets have the same parameters, up to rounding.
pub fn has_same_values(a: &Value, b: &Value) -> bool {
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
