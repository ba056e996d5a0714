//! External axes of a program, such as a track under the robot. They are not read; a program is refused if one of them moves between its points.

use crate::measurement::programs::point::{Point, Reason};
use crate::measurement::programs::program::{Program, Unread};
use std::collections::BTreeMap;

/// An axis moves if its values at the points differ by more than this, mm or degrees.
const STANDSTILL: f64 = 0.05;

pub(super) struct ExternalAxes {
    /// The reason for a refusal, if an axis moves.
    pub moving: Option<String>,
    /// Axes that have the same nonzero value at all points, each with the line of the first point.
    pub standing: Vec<Unread>,
}

/// A value of an axis: the point that has it, and its line.
struct At<'p> {
    value: f64,
    point: &'p Point,
    line: usize,
}

/// The external axes of the points that are read. `text` is the text of the program.
pub(super) fn external_axes(program: &Program, text: &str) -> ExternalAxes {
    let mut axes: BTreeMap<&str, Vec<At>> = BTreeMap::new();
    for (point, line) in program.points.iter().zip(&program.lines) {
        for (name, at) in &point.external {
            let value = text[at.clone()].parse().unwrap_or(0.0);
            let line = *line;
            axes.entry(name)
                .or_default()
                .push(At { value, point, line });
        }
    }
    let by_value = |a: &&At, b: &&At| a.value.total_cmp(&b.value);
    let moving = axes.iter().find_map(|(name, values)| {
        let least = values.iter().min_by(by_value)?;
        let largest = values.iter().max_by(by_value)?;
        let is_moving = largest.value - least.value > STANDSTILL;
        is_moving.then(|| in_words(name, least, largest))
    });
    let standing = axes.into_iter().filter_map(|(name, values)| {
        let first = values.first().filter(|at| at.value != 0.0)?;
        Some(Unread {
            line: first.line,
            name: name.to_owned(),
            reason: Reason::ExternalAxis,
        })
    });
    ExternalAxes {
        moving,
        standing: standing.collect(),
    }
}

fn in_words(name: &str, least: &At, largest: &At) -> String {
    format!(
        "the external axis {name} moves between the points: {} at {} (line {}) and {} at {} (line {}). It is not read, and a track moves the robot's base: measure with \
         it at one place. If it stood at a few places, write the points of each into a program of its own; if it moves neither robot nor reflector, remove its \
         values",
        least.value, least.point.name, least.line, largest.value, largest.point.name, largest.line
    )
}
