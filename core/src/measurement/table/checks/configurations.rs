//! Finds a column that is read as the label of a configuration and says something else, such as the posture of the arm.

use crate::measurement::issue::Issue;
use crate::measurement::set::Point;
use std::collections::BTreeMap;

/// Joint values of one pose of the arm differ by less than this, rad (1°). It is far above the difference of returned joint values.
const MAX_APART_RAD: f64 = std::f64::consts::PI / 180.0;

/// Refuses labels that poses with different joint values share. `column` is the name of their column.
pub fn unlike_poses(points: &[Point], column: &str) -> Option<Issue> {
    let mut firsts: BTreeMap<&str, usize> = BTreeMap::new();
    let labelled = points.iter().enumerate();
    for (row, point) in labelled.filter(|(_, point)| !point.configuration.is_empty()) {
        let first = *firsts.entry(&point.configuration).or_insert(row);
        let joints = points[first].q_rad.iter().zip(&point.q_rad);
        let apart = joints.map(|(a, b)| (a - b).abs()).enumerate();
        let (joint, apart_rad) = apart.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        if apart_rad > MAX_APART_RAD {
            let detail = format!(
                "rows {first} and {row} have the label {:?}, and their values of joint {} differ by {:.1}°: rows with the same label have to be of one pose of the \
                 arm. If the column says something else, such as the posture of the arm, leave it aside in the column mapping: {{\"ignore\": [{column:?}]}}",
                point.configuration,
                joint + 1,
                apart_rad.to_degrees()
            );
            let issue = Issue::new("configuration_suspect", detail);
            return Some(issue.in_row(row).in_column(column.to_owned()));
        }
    }
    None
}
