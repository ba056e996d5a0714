//! A robot program: its language, the points that are read, and what is not read.

use crate::measurement::programs::point::{Point, Reason};

/// Language of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// KRL.
    Kuka,
    /// RAPID.
    Abb,
    /// A listing of a TP program.
    Fanuc,
}

impl Language {
    /// Advice what to export instead of Cartesian points.
    pub(super) fn remedy(self) -> &'static str {
        match self {
            Self::Kuka => "Declare them as joint values (E6AXIS), or log $AXIS_ACT at each of them",
            Self::Abb => {
                "Write them as jointtarget (CJointT() or CalcJointT), or log the joint values at each of them"
            }
            Self::Fanuc => {
                "Change the representation of the positions to joint values (POSITION, REPRE, Joint) and export the listing again"
            }
        }
    }
}

/// A point that is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unread {
    /// The line on which it begins, counted from 1.
    pub line: usize,
    /// Its name.
    pub name: String,
    /// Why it is not read.
    pub reason: Reason,
}

/// A robot program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// Its language.
    pub language: Language,
    /// The points whose joint values are numbers, in their order.
    pub points: Vec<Point>,
    /// The line on which each of these points begins, counted from 1.
    pub lines: Vec<usize>,
    /// The points that are not read.
    pub unread: Vec<Unread>,
}

/// Information about a program that is not part of the table made from it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProgramRows {
    /// The line of each point in the program, counted from 1.
    pub lines: Vec<usize>,
    /// The points that are not read.
    pub unread: Vec<Unread>,
    /// Number of lines on which no point begins.
    pub n_other_lines: usize,
    /// Why the program is refused when it is uploaded: an external axis moves between its points.
    pub moving_axis: Option<String>,
}
