//! Joins the robot's file and the instrument's file. The rows with joint values and the rows with positions are paired by name, number, time or
//! order.

use crate::measurement::columns::meaning::key;
use crate::measurement::columns::names::Key;
use crate::measurement::join::labels::{
    TwoWords, are_numbered, exact, last_part, lower, number, numbers_in_names, only_number,
    without_punctuation,
};
use crate::measurement::join::options::{Pairs, error};
use crate::measurement::join::time::{Clock, MAX_APART, by_time, extent_mm, times};
use crate::measurement::set::{Point, SAME_JOINT_RAD};
use crate::measurement::table::checks::repeats::rows_again;
use crate::measurement::table::points::{Content, name_in_one_line};
use std::collections::{BTreeMap, BTreeSet};

pub use crate::measurement::join::options::{JoinBy, JoinError, JoinOptions};

/// A row without a partner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leftover {
    /// Its line, counted from 1.
    pub line: usize,
    /// Its name, number or time.
    pub label: String,
}

/// How two files were joined.
#[derive(Clone, Debug, PartialEq)]
pub struct Join {
    /// The key by which the rows were paired.
    pub by: JoinBy,
    /// Number of pairs.
    pub n_joined: usize,
    /// By time: largest difference between the times of a pair, s.
    pub tolerance_s: Option<f64>,
    /// By time: the robot's clock minus the instrument's clock, s.
    pub clock_offset_s: Option<f64>,
    /// By name: whether the names agree only without punctuation, spaces and leading zeros, or by the numbers in them.
    pub loose_names: bool,
    /// By time: whether the instrument's file is a continuous log. Only the standstills of a log are used.
    pub instrument_log: bool,
    /// Rows of the robot's file without a partner.
    pub leftover_robot: Vec<Leftover>,
    /// Rows of the instrument's file without a partner.
    pub leftover_instrument: Vec<Leftover>,
}

/// One possible pairing of the rows.
#[derive(Clone, Debug)]
struct Pairing {
    by: JoinBy,
    pairs: Pairs,
    clock: Option<Clock>,
    /// Whether names were compared loosely.
    is_loose: bool,
    /// Number of rows of the robot's file that can have a partner. By time, this is the number of standstills.
    n_robot: usize,
}

impl Pairing {
    fn n_joined(&self) -> usize {
        self.pairs.iter().flatten().count()
    }

    /// Whether at least half of the rows that can be paired are paired.
    fn is_most(&self) -> bool {
        let possible = self.pairs.len().min(self.n_robot);
        self.n_joined() > 0 && 2 * self.n_joined() >= possible
    }

    fn contradicts(&self, other: &Self, robot: &Content) -> bool {
        let pairs = self.pairs.iter().zip(&other.pairs);
        pairs
            .filter_map(|(a, b)| a.zip(*b))
            .any(|(a, b)| !same_joints(&robot.points[a], &robot.points[b]))
    }
}

fn same_joints(a: &Point, b: &Point) -> bool {
    let mut joints = a.q_rad.iter().zip(&b.q_rad);
    joints.all(|(a, b)| (a - b).abs() < SAME_JOINT_RAD)
}

/// Joins the two files. The result has the positions in their order, each with its joint values.
///
/// # Errors
/// [`JoinError`] if no key pairs the rows, or if two keys pair them in different ways.
pub fn join(
    robot: &Content,
    instrument: &Content,
    options: &JoinOptions,
) -> Result<(Vec<Point>, Join), JoinError> {
    let wanted: Vec<JoinBy> = match options.by {
        Some(by) => vec![by],
        None => vec![JoinBy::Name, JoinBy::Number, JoinBy::Time],
    };
    let mut found: Vec<Pairing> = Vec::new();
    let mut why: Option<JoinError> = None;
    for by in wanted {
        match pair(robot, instrument, by, options) {
            Ok(Some(pairing)) => found.push(pairing),
            Ok(None) if options.by.is_some() => {
                let (means, in_ms) = match by {
                    JoinBy::Time => ("time_s", "; milliseconds are time_ms"),
                    _ => (by.as_str(), ""),
                };
                return Err(error(
                    "join_unclear",
                    format!(
                        "both files need a column for join by {}: name it in the column mapping: \
                         {{\"robot\": {{\"{means}\": \"COLUMN\"}}, \"instrument\": {{\"{means}\": \"COLUMN\"}}}}{in_ms}",
                        by.as_str()
                    ),
                ));
            }
            Ok(None) => {}
            Err(error) if options.by.is_some() => return Err(error),
            Err(error) => why = why.or(Some(error)),
        }
    }
    let usable: Vec<&Pairing> = found.iter().filter(|pairing| pairing.is_most()).collect();
    let Some(best) = usable.first().copied().or_else(|| {
        found
            .iter()
            .filter(|p| options.by.is_some() && p.n_joined() > 0)
            .max_by_key(|p| p.n_joined())
    }) else {
        return Err(why.unwrap_or_else(|| nothing_pairs(robot, instrument, options.by)));
    };
    if let Some(other) = usable.iter().find(|other| other.contradicts(best, robot)) {
        return Err(error(
            "two_readings",
            format!(
                "the rows pair in one way by {} and in another by {}: state which in the column mapping: {{\"join\": {{\"by\": \"{0}\"}}}}",
                best.by.as_str(),
                other.by.as_str()
            ),
        ));
    }
    if options.refuse_apart && matches!(best.by, JoinBy::Name | JoinBy::Number) {
        refuse_apart(instrument, best)?;
    }
    let joined = points(robot, instrument, best);
    if options.refuse_apart {
        refuse_again(&joined, instrument, best)?;
    }
    Ok((joined, summary(robot, instrument, best)))
}

/// Refuses an instrument's file that contains a table twice.
fn refuse_again(
    joined: &[Point],
    instrument: &Content,
    pairing: &Pairing,
) -> Result<(), JoinError> {
    let again = rows_again(joined);
    let Some((row, first)) = again.first() else {
        return Ok(());
    };
    let paired = instrument.lines.iter().zip(&pairing.pairs);
    let paired = paired.filter(|(_, pair)| pair.is_some());
    let lines: Vec<usize> = paired.map(|(line, _)| *line).collect();
    let detail = format!(
        "line {} of the instrument's file agrees with line {} in every digit, as {} lines in all do with earlier ones: repeated measurements differ by their noise, so a table \
         stands there twice; remove these lines",
        lines[*row],
        lines[*first],
        again.len()
    );
    Err(error("rows_twice", detail))
}

/// The pairs as points. Their name is that of the posture in the robot's file; where that has no names, the instrument's, or the number.
fn points(robot: &Content, instrument: &Content, pairing: &Pairing) -> Vec<Point> {
    let numbers = cells(robot, JoinBy::Number).filter(|_| pairing.by == JoinBy::Number);
    let paired = instrument.points.iter().zip(&pairing.pairs);
    paired
        .filter_map(|(point, pair)| {
            let posture = &robot.points[(*pair)?];
            let name = posture.name.as_ref().or(point.name.as_ref()).cloned();
            Some(Point {
                q_rad: posture.q_rad.clone(),
                name: name.or_else(|| name_in_one_line(numbers?.1.get((*pair)?)?)),
                ..point.clone()
            })
        })
        .collect()
}

/// The error if no key pairs the rows. It shows examples from the columns that might pair them.
fn nothing_pairs(robot: &Content, instrument: &Content, by: Option<JoinBy>) -> JoinError {
    let labels = |content: &Content| {
        let column = cells(content, JoinBy::Name).or_else(|| cells(content, JoinBy::Number));
        column.map(|(_, cells)| {
            let some: Vec<String> = cells
                .iter()
                .take(2)
                .map(|label| format!("{label:?}"))
                .collect();
            some.join(", ")
        })
    };
    let seen = match (labels(robot), labels(instrument)) {
        (Some(ours), Some(theirs)) => format!(
            ". The robot's file has {ours} …, the instrument's {theirs} …: write the same names in both"
        ),
        (None, None) => String::new(),
        (None, _) => ". The robot's file has no column of names or numbers that is known".into(),
        (_, None) => {
            ". The instrument's file has no column of names or numbers that is known".into()
        }
    };
    let by_number = match by {
        Some(JoinBy::Number) => "",
        _ => {
            ". If the numbers in the names say it, say so in the column mapping: {\"join\": {\"by\": \"number\"}}; names that are called otherwise \
             than most are then left over"
        }
    };
    error(
        "join_unclear",
        format!(
            "nothing pairs the rows of the two files: both need a column with the points' names, numbers or times that agree{seen}. Name them \
             in the column mapping: {{\"robot\": {{\"name\": \"COLUMN\"}}, \"instrument\": {{\"name\": \"COLUMN\"}}}}. If row belongs to row, say so \
             in the column mapping: {{\"join\": {{\"by\": \"order\"}}}}{by_number}"
        ),
    )
}

/// Refuses positions with the same name, reflector and station that are too far apart to be repetitions of one point.
fn refuse_apart(instrument: &Content, pairing: &Pairing) -> Result<(), JoinError> {
    let joined: Vec<(usize, usize)> = (pairing.pairs.iter().enumerate())
        .filter_map(|(row, pair)| Some((row, (*pair)?)))
        .collect();
    let position = |row: usize| instrument.points[row].position_mm;
    let limit_mm = MAX_APART * extent_mm(joined.iter().map(|(row, _)| position(*row)));
    let mut first: BTreeMap<_, usize> = BTreeMap::new();
    for (row, robot_row) in joined {
        let point = &instrument.points[row];
        let known = *first
            .entry((robot_row, point.target, &point.target_name, &point.station))
            .or_insert(row);
        let apart_mm = (position(row) - position(known)).norm();
        if apart_mm > limit_mm {
            let label = label(instrument, pairing.by, row);
            let detail = format!(
                "{label:?} is in lines {} and {} of the instrument's file, with positions {apart_mm:.3} mm apart: that is no repetition. Give each point its \
                 own name and remove what belongs to no posture of the robot, or say by a column target or station which reflector or set-up it was",
                instrument.lines[known], instrument.lines[row]
            );
            return Err(error("duplicate_name", detail));
        }
    }
    Ok(())
}

/// The meaning and the cells of the column of a join key.
fn cells(content: &Content, by: JoinBy) -> Option<(&str, &[String])> {
    let is_it = |means: &str| {
        matches!(
            (key(means), by),
            (Some(Key::Name), JoinBy::Name)
                | (Some(Key::Number), JoinBy::Number)
                | (Some(Key::Time(_)), JoinBy::Time)
        )
    };
    let column = content.keys.iter().find(|(means, _)| is_it(means))?;
    Some((&column.0, &column.1))
}

/// What a row is called: its cell in the column by which rows are paired, or its name or number.
fn label(content: &Content, by: JoinBy, row: usize) -> &str {
    let columns = [by, JoinBy::Name, JoinBy::Number].into_iter();
    let column = columns.filter_map(|by| cells(content, by)).next();
    column.map_or("", |(_, cells)| cells[row].as_str())
}

fn pair(
    robot: &Content,
    instrument: &Content,
    by: JoinBy,
    options: &JoinOptions,
) -> Result<Option<Pairing>, JoinError> {
    let n_robot = robot.points.len();
    let plain = |pairs| {
        Ok(Some(Pairing {
            by,
            pairs,
            clock: None,
            is_loose: false,
            n_robot,
        }))
    };
    if by == JoinBy::Order {
        let (a, b) = (n_robot, instrument.points.len());
        if a != b {
            let detail = format!(
                "the robot's file has {a} rows and the instrument's {b}: by order they do not pair. Remove the rows that belong to no row of the other \
                 file, or pair by a column that both have, in the column mapping: {{\"join\": {{\"by\": \"number\"}}}} (or name, or time): rows without a partner \
                 are then left over"
            );
            return Err(error("join_unclear", detail));
        }
        return plain((0..a).map(Some).collect());
    }
    let has_name = |content| cells(content, JoinBy::Name).is_some();
    let has_number = |content| cells(content, JoinBy::Number).is_some();
    // Who says number may mean the numbers in the names, unless both files have a column of numbers.
    let is_in_names = by == JoinBy::Number
        && options.by.is_some()
        && !(has_number(robot) && has_number(instrument));
    let have_names = has_name(robot) && has_name(instrument);
    let of_name = |content| match by {
        JoinBy::Name if options.loose_names => {
            cells(content, by).or_else(|| cells(content, JoinBy::Number))
        }
        JoinBy::Number if is_in_names && have_names => cells(content, JoinBy::Name),
        JoinBy::Number if is_in_names => {
            cells(content, by).or_else(|| cells(content, JoinBy::Name))
        }
        _ => cells(content, by),
    };
    let (Some((means, ours)), Some((their_means, theirs))) = (of_name(robot), of_name(instrument))
    else {
        return Ok(None);
    };
    if by == JoinBy::Name && !has_name(robot) && !has_name(instrument) {
        return Ok(None);
    }
    match by {
        JoinBy::Time => {
            let times = (
                times(means, ours, &robot.lines, "robot")?,
                times(their_means, theirs, &instrument.lines, "instrument")?,
            );
            let (pairs, clock) = by_time(
                &robot.points,
                &times.0,
                &instrument.points,
                &times.1,
                options,
            )?;
            let n_robot = clock.n_standstills;
            Ok(Some(Pairing {
                by,
                pairs,
                clock: Some(clock),
                is_loose: false,
                n_robot,
            }))
        }
        JoinBy::Number if is_in_names => {
            let [ours, theirs] = numbers_in_names(ours, theirs).map_err(two_words)?;
            plain(by_label(robot, &ours, &theirs, &[number])?)
        }
        JoinBy::Number => plain(by_label(robot, ours, theirs, &[number])?),
        _ => {
            let strict = by_label(robot, ours, theirs, &[exact, lower, last_part])?;
            let count = |pairs: &Pairs| pairs.iter().flatten().count();
            let mut loose = match options.loose_names {
                true => paired_as(robot, ours, theirs, without_punctuation).ok(),
                false => None,
            };
            let has_none = |pairs: &Pairs| count(pairs) == 0;
            if loose.as_ref().is_some_and(has_none) && has_none(&strict) {
                loose = by_numbers_in_names(robot, ours, theirs);
            }
            let is_loose = |pairs: &Pairs| count(pairs) > count(&strict);
            match loose.filter(is_loose) {
                Some(pairs) => Ok(Some(Pairing {
                    by,
                    pairs,
                    clock: None,
                    is_loose: true,
                    n_robot,
                })),
                None => Ok(Some(Pairing {
                    by,
                    pairs: strict,
                    clock: None,
                    // In a file without names, numbers are used as names.
                    is_loose: by == JoinBy::Name && !(has_name(robot) && has_name(instrument)),
                    n_robot,
                })),
            }
        }
    }
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
        let n = pairs
            .as_ref()
            .map_or(usize::MAX, |pairs| pairs.iter().flatten().count());
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

fn summary(robot: &Content, instrument: &Content, pairing: &Pairing) -> Join {
    let taken: BTreeSet<usize> = pairing.pairs.iter().flatten().copied().collect();
    let is_leftover = |row: &usize| match &pairing.clock {
        // A log has many rows for one standstill, and rows in which the robot moves. Only the row that represents a standstill can be a leftover.
        Some(clock) => clock.standstills.contains(row) && !taken.contains(row),
        None => !taken.contains(row),
    };
    let leftover = |content: &Content, row: usize| Leftover {
        line: content.lines[row],
        label: label(content, pairing.by, row).to_owned(),
    };
    let without = pairing.pairs.iter().enumerate().filter(|(row, pair)| {
        let stands = pairing
            .clock
            .as_ref()
            .and_then(|clock| clock.instrument_rows.as_ref());
        pair.is_none() && stands.is_none_or(|rows| rows.contains(row))
    });
    Join {
        by: pairing.by,
        n_joined: pairing.n_joined(),
        tolerance_s: pairing.clock.as_ref().map(|clock| clock.tolerance_s),
        clock_offset_s: pairing.clock.as_ref().map(|clock| clock.offset_s),
        loose_names: pairing.is_loose,
        instrument_log: pairing
            .clock
            .as_ref()
            .is_some_and(|clock| clock.instrument_rows.is_some()),
        leftover_robot: (0..robot.points.len())
            .filter(is_leftover)
            .map(|row| leftover(robot, row))
            .collect(),
        leftover_instrument: without.map(|(row, _)| leftover(instrument, row)).collect(),
    }
}
