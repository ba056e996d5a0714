//! Checks for rows that are no measurements, and for rows whose cells are shifted.

pub mod configurations;
pub mod external_columns;
pub mod flags;
mod group_statistics;
pub mod names;
mod not_measured;
pub mod point_groups;
pub mod reflectors;
pub mod repeats;
pub mod row_ends;
pub mod statistics;

use crate::measurement::issue::Issue;
use crate::measurement::set::Point;

/// Refuses rows whose values show that they are no measurements. `reflectors` are the cells with the reflector of each row, if the file has
/// them; `millimetres` is the unit of each coordinate in the file.
pub fn no_measurements(
    points: &[Point],
    reflectors: &[String],
    millimetres: [f64; 3],
    has_joints: bool,
) -> Vec<Issue> {
    let mut found = not_measured::not_measured(points, millimetres);
    if has_joints && found.is_empty() {
        found = repeats::repeats(points);
    }
    if has_joints && found.is_empty() {
        found = not_measured::pulses(points);
    }
    if found.is_empty() {
        found = statistics::statistics(points);
    }
    if found.is_empty() {
        found = group_statistics::group_statistics(points, reflectors, millimetres);
    }
    found
}
