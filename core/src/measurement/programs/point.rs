//! Points of robot programs: those whose joint values are numbers, and those that are not read.

use crate::measurement::programs::text::is_number;
use std::ops::Range;

/// Larger values mean that the axis has no value, such as ABB's 9E9.
const NO_ANGLE: f64 = 1e6;
/// Maximum number of joints of a point, including external axes.
const MAX_AXES: usize = 12;

/// A point whose joint values are numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Point {
    /// Where its declaration begins, bytes.
    pub at: usize,
    /// Its name.
    pub name: String,
    /// Its number; empty if it has none.
    pub number: String,
    /// Where its joint values are, bytes.
    pub angles: Vec<Range<usize>>,
    /// Where the values of its external axes are, bytes, with their names.
    pub external: Vec<(String, Range<usize>)>,
}

/// Why a point is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// It is a Cartesian position.
    Cartesian,
    /// A joint value is no number.
    NotNumbers,
    /// It has fewer joint values than other points of the program.
    SomeAxes,
    /// It is no point: an external axis has the same value at all points.
    ExternalAxis,
}

impl Reason {
    /// Text of the reason.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cartesian => "a Cartesian position has no joint values",
            Self::NotNumbers => "its joint values are not all numbers (9E9 is none)",
            Self::SomeAxes => "it has fewer joint values than the other points",
            Self::ExternalAxis => "an external axis; it stands at one value in all points",
        }
    }
}

/// A point that is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Other {
    pub(super) at: usize,
    pub(super) name: String,
    pub(super) reason: Reason,
}

/// The points of a program.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub(super) points: Vec<Point>,
    pub(super) others: Vec<Other>,
}

impl Found {
    pub(super) fn is_empty(&self) -> bool {
        self.points.is_empty() && self.others.is_empty()
    }

    pub(super) fn other(&mut self, at: usize, name: &str, reason: Reason) {
        self.others.push(Other {
            at,
            name: name.to_owned(),
            reason,
        });
    }

    /// Adds a point. Its joint values must be numbers; otherwise it is not read. External axes without a value are left out.
    pub(super) fn point(
        &mut self,
        text: &str,
        at: usize,
        name: &str,
        angles: Vec<Range<usize>>,
        external: Vec<(String, Range<usize>)>,
    ) {
        let is_usable = (1..=MAX_AXES).contains(&angles.len());
        let is_angle = |angle: &Range<usize>| {
            let angle = &text[angle.clone()];
            is_number(angle) && angle.parse().is_ok_and(|angle: f64| angle.abs() < NO_ANGLE)
        };
        let external = external.into_iter();
        let external = external.filter(|(_, value)| is_angle(value)).collect();
        if !is_usable || !angles.iter().all(is_angle) {
            return self.other(at, name, Reason::NotNumbers);
        }
        self.points.push(Point {
            at,
            number: number_of(name),
            name: name.to_owned(),
            angles,
            external,
        });
    }

    /// Moves points with fewer joint values than most to the points that are not read.
    pub(super) fn finish(&mut self) {
        let count = |point: &Point| point.angles.len();
        let most = self.points.iter().map(count).max().unwrap_or(0);
        for point in self.points.extract_if(.., |point| count(point) < most) {
            self.others.push(Other {
                at: point.at,
                name: point.name,
                reason: Reason::SomeAxes,
            });
        }
        self.others.sort_by_key(|other| other.at);
    }
}

/// The digits at the end of a name.
fn number_of(name: &str) -> String {
    let name = name.trim_end_matches([']', '}']);
    let digits = name.len() - name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    name[name.len() - digits..].to_owned()
}
