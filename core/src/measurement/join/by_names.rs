//! Pairs the rows of two files by the points' names and numbers.

use crate::measurement::join::labels::{
    TwoWords, are_numbered, exact, last_part, lower, number, numbers_in_names, only_number,
    without_punctuation,
};
use crate::measurement::join::name_parts::{LeftOut, ways};
use crate::measurement::join::options::{JoinError, JoinOptions, Pairs, error, n_paired};
use crate::measurement::set::{Point, SAME_JOINT_RAD};
use crate::measurement::table::points::Content;
use std::collections::{BTreeMap, BTreeSet};

/// How names are compared.
#[derive(Clone, Copy)]
pub enum Names {
    /// Columns of numbers.
    Numbers,
    /// The numbers in the names, as the caller says.
    NumbersIn,
    /// Names.
    Of {
        /// Whether they may differ in signs, spaces and zeros.
        loosely: bool,
        /// Whether both files have names.
        have_names: bool,
    },
}

/// Rows that were paired by name or number.
pub struct Found {
    pub pairs: Pairs,
    pub is_loose: bool,
    pub left_out: Option<LeftOut>,
}

/// Pairs rows by their names. If nothing pairs them, parts are left out of the names: what all of them begin with, and numbers of repetitions.
///
/// # Errors
/// `duplicate_name` if a name has several postures; `join_unclear` if numbers in names have two meanings.
pub fn by_names(
    robot: &Content,
    ours: &[String],
    theirs: &[String],
    how: Names,
    options: &JoinOptions,
) -> Result<Found, JoinError> {
    // An upload that was stored is read as it was accepted.
    let is_again = !options.refuse_apart;
    if let Some(left_out) = options.left_out.as_ref().filter(|_| is_again) {
        let [ours, theirs] = left_out.names(ours, theirs);
        let pairs = by_parts(robot, &ours, &theirs, how)?;
        return Ok(with_left_out(pairs, left_out));
    }
    let found = as_they_are(robot, ours, theirs, how)?;
    if is_again || matches!(how, Names::Numbers) || n_paired(&found.pairs) > 0 {
        return Ok(found);
    }
    for left_out in ways(ours, theirs) {
        let [ours, theirs] = left_out.names(ours, theirs);
        match by_parts(robot, &ours, &theirs, how) {
            Ok(pairs) if 2 * n_paired(&pairs) >= ours.len().min(theirs.len()) => {
                return Ok(with_left_out(pairs, &left_out));
            }
            _ => {}
        }
    }
    Ok(found)
}

fn with_left_out(pairs: Pairs, left_out: &LeftOut) -> Found {
    Found {
        pairs,
        is_loose: true,
        left_out: Some(left_out.clone()),
    }
}

/// Pairs names of which parts were left out.
fn by_parts(
    robot: &Content,
    ours: &[String],
    theirs: &[String],
    how: Names,
) -> Result<Pairs, JoinError> {
    let pairs = paired_as(robot, ours, theirs, without_punctuation)?;
    match (n_paired(&pairs), how) {
        (0, Names::NumbersIn) => by_numbers(robot, ours, theirs),
        (0, _) => Ok(by_numbers_in_names(robot, ours, theirs).unwrap_or(pairs)),
        _ => Ok(pairs),
    }
}

fn as_they_are(
    robot: &Content,
    ours: &[String],
    theirs: &[String],
    how: Names,
) -> Result<Found, JoinError> {
    let plain = |pairs| Found {
        pairs,
        is_loose: false,
        left_out: None,
    };
    let (loosely, have_names) = match how {
        Names::Numbers => return Ok(plain(by_label(robot, ours, theirs, &[number])?)),
        Names::NumbersIn => return Ok(plain(by_numbers(robot, ours, theirs)?)),
        Names::Of {
            loosely,
            have_names,
        } => (loosely, have_names),
    };
    let strict = by_label(robot, ours, theirs, &[exact, lower, last_part])?;
    let mut loose = match loosely {
        true => paired_as(robot, ours, theirs, without_punctuation).ok(),
        false => None,
    };
    let has_none = |pairs: &Pairs| n_paired(pairs) == 0;
    if loose.as_ref().is_some_and(has_none) && has_none(&strict) {
        loose = by_numbers_in_names(robot, ours, theirs);
    }
    match loose.filter(|pairs| n_paired(pairs) > n_paired(&strict)) {
        Some(pairs) => Ok(Found {
            is_loose: true,
            ..plain(pairs)
        }),
        None => Ok(Found {
            is_loose: !have_names,
            ..plain(strict)
        }),
    }
}

/// Pairs rows by the numbers in their names, as a caller says.
///
/// # Errors
/// `join_unclear` if the names have numbers of two kinds.
pub fn by_numbers(robot: &Content, ours: &[String], theirs: &[String]) -> Result<Pairs, JoinError> {
    let [ours, theirs] = numbers_in_names(ours, theirs).map_err(two_words)?;
    by_label(robot, &ours, &theirs, &[number])
}

/// The error if the points' names cannot be told from others with numbers.
fn two_words(TwoWords(first, second): TwoWords) -> JoinError {
    error(
        "join_unclear",
        format!(
            "one file has names with {first:?} and names with {second:?}, and the numbers of both could be the points': remove the rows that are no points, \
             or give the points the same names in both files"
        ),
    )
}

/// Pairs names such as `P1` and `Point 1` by their numbers, if no number is missing or has two names in one file.
fn by_numbers_in_names(robot: &Content, ours: &[String], theirs: &[String]) -> Option<Pairs> {
    let form = |label: &str| only_number(label).unwrap_or_default();
    // A name that is the same in every row is not the name of a point.
    let are_several = |labels: &[String]| labels.iter().any(|label| label != &labels[0]);
    let can_pair = are_several(ours) && are_several(theirs);
    match can_pair && are_numbered(ours) && are_numbered(theirs) {
        true => paired_as(robot, ours, theirs, form).ok(),
        false => None,
    }
}

/// Pairs rows with equal labels. The labels are compared in several forms; the form that pairs the most rows is used.
fn by_label(
    robot: &Content,
    ours: &[String],
    theirs: &[String],
    forms: &[fn(&str) -> String],
) -> Result<Pairs, JoinError> {
    let mut best: Option<Result<Pairs, JoinError>> = None;
    let mut most = 0;
    for form in forms {
        let pairs = paired_as(robot, ours, theirs, *form);
        let n = pairs.as_ref().map_or(usize::MAX, |pairs| n_paired(pairs));
        // A form that makes two different names equal gives an error and is never better.
        if best.is_none() || n > most && pairs.is_ok() {
            (most, best) = (n, Some(pairs));
        }
    }
    best.unwrap_or_else(|| Ok(vec![]))
}

fn paired_as(
    robot: &Content,
    ours: &[String],
    theirs: &[String],
    form: fn(&str) -> String,
) -> Result<Pairs, JoinError> {
    let mut rows: BTreeMap<String, usize> = BTreeMap::new();
    let wanted: BTreeSet<String> = theirs.iter().map(|label| form(label)).collect();
    for (row, label) in ours
        .iter()
        .enumerate()
        .filter(|(_, label)| !label.is_empty())
    {
        let label = form(label);
        let first = *rows.entry(label.clone()).or_insert(row);
        if wanted.contains(&label) && !same_joints(&robot.points[first], &robot.points[row]) {
            let detail = format!(
                "{label:?} is in lines {} and {} of the robot's file with different joint values: which of them was measured? Give each its own name",
                robot.lines[first], robot.lines[row]
            );
            return Err(error("duplicate_name", detail));
        }
    }
    Ok(theirs
        .iter()
        .map(|label| rows.get(&form(label)).copied())
        .collect())
}

/// Whether two rows have the same posture.
pub fn same_joints(a: &Point, b: &Point) -> bool {
    let mut joints = a.q_rad.iter().zip(&b.q_rad);
    joints.all(|(a, b)| (a - b).abs() < SAME_JOINT_RAD)
}
