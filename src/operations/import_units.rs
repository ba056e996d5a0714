//! Finds numbers in a table of link parameters that are impossible in the unit of their column: radians in a column in degrees, metres in a
//! column in millimetres.

use crate::kinematics::Link;
use crate::wire::issue::Issue;
use std::f64::consts::FRAC_PI_2;

/// Largest difference between a rounded multiple of π/2 (1.57) and its exact value.
const ROUNDED: f64 = 1e-3;
/// Minimum number of links for judging the reach.
const MIN_LINKS: usize = 3;
/// Smallest plausible reach of an arm, mm.
const MIN_REACH_MM: f64 = 10.0;

/// The issue of a column in degrees whose numbers are all multiples of π/2. `column` is its name, `radians` the name with the other unit.
pub fn radians_under_degrees(column: &str, radians: &str, degrees: &[f64]) -> Option<Issue> {
    let angles: Vec<f64> = degrees.iter().copied().filter(|deg| *deg != 0.0).collect();
    let is_right = |angle: &f64| {
        let turns = (angle / FRAC_PI_2).round();
        turns != 0.0 && turns.abs() <= 4.0 && (angle - turns * FRAC_PI_2).abs() < ROUNDED
    };
    let first = angles.first().filter(|_| angles.iter().all(is_right))?;
    Some(Issue {
        column: Some(column.to_owned()),
        code: "not_in_degrees".into(),
        detail: format!(
            "column {column} is in degrees, and all its numbers are multiples of π/2 ({first:.4}), as right angles are in radians: name it {radians}, or write degrees"
        ),
        ..Issue::default()
    })
}

/// The issue of lengths in millimetres that are too small for an arm.
pub fn metres_under_millimetres(column: &str, links: &[Link]) -> Option<Issue> {
    let reach_mm: f64 = links
        .iter()
        .map(|link| link.a_mm.abs() + link.d_mm.abs())
        .sum();
    let is_short = links.len() >= MIN_LINKS && reach_mm > 0.0 && reach_mm < MIN_REACH_MM;
    is_short.then(|| Issue {
        column: Some(column.to_owned()),
        code: "not_in_millimetres".into(),
        detail: format!(
            "the lengths of all links add up to {reach_mm:.3} mm: if they are metres, name the columns a_m and d_m, or write millimetres"
        ),
        ..Issue::default()
    })
}

#[cfg(test)]
mod tests {
    use super::{metres_under_millimetres, radians_under_degrees};
    use crate::kinematics::Link;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn numbers_of_another_unit_are_told() {
        let right = FRAC_PI_2 + 4e-6;
        for degrees in [&[right, 0.0, -right][..], &[2.0 * right, right - 8e-4]] {
            let issue = radians_under_degrees("alpha_deg", "alpha_rad", degrees).unwrap();
            assert!(issue.detail.contains("name it alpha_rad"), "{issue:?}");
        }
        for degrees in [&[90.0, 0.0][..], &[0.0, 0.0], &[right, 0.3], &[1.52]] {
            assert!(radians_under_degrees("alpha_deg", "alpha_rad", degrees).is_none());
        }
        let links = |a_mm: f64| {
            vec![
                Link {
                    a_mm,
                    ..Link::default()
                };
                6
            ]
        };
        assert!(metres_under_millimetres("a_mm", &links(0.4)).is_some());
        assert!(metres_under_millimetres("a_mm", &links(6.5)).is_none());
        assert!(metres_under_millimetres("a_mm", &links(0.0)).is_none());
    }
}
