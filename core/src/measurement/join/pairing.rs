//! Joins the robot's file and the instrument's file. The rows with joint values and the rows with positions are paired by name, number, time or
//! order.

use crate::measurement::columns::meaning::key;
use crate::measurement::columns::names::Key;
use crate::measurement::join::by_names::{Names, by_names, by_numbers, same_joints};
use crate::measurement::join::name_parts::LeftOut;
use crate::measurement::join::options::{Pairs, error, n_paired};
use crate::measurement::join::time::{Clock, MAX_APART, by_time, extent_mm};
use crate::measurement::join::times::{over_midnight, times};
use crate::measurement::set::Point;
use crate::measurement::table::checks::point_groups::{point_in_group, several_groups};
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
    /// By name or number: what was left out of the names.
    pub left_out: Option<LeftOut>,
    /// By time: whether the instrument's file is a continuous log. Only the standstills of a log are used.
    pub instrument_log: bool,
    /// By time: whether slow parts of motions count as no standstills, as in [`JoinOptions`].
    pub settled_standstills: bool,
    /// By time: whether times of day fall back, and the rows behind are those of the next day.
    pub over_midnight: bool,
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
    /// By name or number: what was left out of the names.
    left_out: Option<LeftOut>,
    /// Number of rows of the robot's file that can have a partner. By time, this is the number of standstills.
    n_robot: usize,
}

impl Pairing {
    fn n_joined(&self) -> usize {
        n_paired(&self.pairs)
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
        refuse_several_groups(robot, instrument, best)?;
        refuse_apart(instrument, best)?;
    }
    let joined = points(robot, instrument, best);
    if options.refuse_apart {
        refuse_again(&joined, instrument, best)?;
    }
    let found = Join {
        settled_standstills: options.settled_standstills && best.by == JoinBy::Time,
        ..summary(robot, instrument, best)
    };
    Ok((joined, found))
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
    let names = |content| {
        let column = cells(content, JoinBy::Name).or_else(|| cells(content, JoinBy::Number));
        column.map(|(_, cells)| cells)
    };
    let examples = |cells: &[String]| {
        let some = cells.iter().take(2).map(|label| format!("{label:?}"));
        some.collect::<Vec<String>>().join(", ")
    };
    let (ours, theirs) = (names(robot), names(instrument));
    let (seen, remedy) = match (ours, theirs) {
        (_, None) if counts_frames(instrument) => (
            ". The instrument's file counts frames, and does not say how many there are in a second".to_owned(),
            ". Say it in the column mapping: {\"instrument\": {\"time_100hz\": \"Frame\"}} for 100 frames a second",
        ),
        (Some(ours), Some(theirs)) => (
            format!(
                ". The robot's file has {} …, the instrument's {} …: write the same names in both",
                examples(ours),
                examples(theirs)
            ),
            ". If other columns have them, say which in the column mapping: {\"robot\": {\"name\": \"COLUMN\"}, \"instrument\": {\"name\": \"COLUMN\"}}",
        ),
        (None, None) => (
            String::new(),
            ". Name them in the column mapping: {\"robot\": {\"name\": \"COLUMN\"}, \"instrument\": {\"name\": \"COLUMN\"}}",
        ),
        (None, _) => (
            ". The robot's file has no column of names or numbers that is known".into(),
            ". Name it in the column mapping: {\"robot\": {\"name\": \"COLUMN\"}}",
        ),
        (_, None) => (
            ". The instrument's file has no column of names or numbers that is known".into(),
            ". Name it in the column mapping: {\"instrument\": {\"name\": \"COLUMN\"}}",
        ),
    };
    let may_be_in_order =
        ours.is_none() || theirs.is_none() || robot.points.len() == instrument.points.len();
    let by_order = match may_be_in_order {
        true => {
            ". If row belongs to row, say so in the column mapping: {\"join\": {\"by\": \"order\"}}"
        }
        false => "",
    };
    let pairs_by_number = by != Some(JoinBy::Number)
        && ours.zip(theirs).is_some_and(|(ours, theirs)| {
            let found = by_numbers(robot, ours, theirs);
            found.is_ok_and(|pairs| 2 * n_paired(&pairs) >= ours.len().min(theirs.len()))
        });
    let by_number = match pairs_by_number {
        true => {
            ". If the numbers in the names say it, say so in the column mapping: {\"join\": {\"by\": \"number\"}}; names that are called otherwise \
             than most are then left over"
        }
        false => "",
    };
    error(
        "join_unclear",
        format!(
            "nothing pairs the rows of the two files: both need a column with the points' names, numbers or times that \
             agree{seen}{remedy}{by_order}{by_number}"
        ),
    )
}

/// Whether a file has a column `Frame` and no time.
fn counts_frames(content: &Content) -> bool {
    let mut ignored = content.understood.ignored.iter();
    cells(content, JoinBy::Time).is_none() && ignored.any(|name| name.eq_ignore_ascii_case("frame"))
}

/// Refuses a posture whose positions stand under several groups of the instrument's file.
fn refuse_several_groups(
    robot: &Content,
    instrument: &Content,
    pairing: &Pairing,
) -> Result<(), JoinError> {
    // Who names several groups says that they are repeated measurements.
    if instrument.understood.groups.len() > 1 {
        return Ok(());
    }
    let paired = instrument.points.iter().zip(&instrument.groups);
    let paired = paired.zip(&pairing.pairs);
    let rows = paired.filter_map(|((point, group), pair)| {
        let name = label(robot, pairing.by, (*pair)?);
        let reflector = point.target_name.clone();
        let reflector = reflector.unwrap_or_else(|| match point.target {
            0 => String::new(),
            target => target.to_string(),
        });
        let key = point_in_group(name, &reflector, point);
        Some((key, group.as_str()))
    });
    match several_groups(rows) {
        Some(detail) => Err(error("two_readings", format!("instrument file: {detail}"))),
        None => Ok(()),
    }
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
            left_out: None,
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
            let mut times = (
                times(means, ours, &robot.lines, "robot")?,
                times(their_means, theirs, &instrument.lines, "instrument")?,
            );
            // Uploads of earlier versions are read as they were.
            let is_over_midnight = options.settled_standstills && {
                let both = (
                    over_midnight(&mut times.0, ours),
                    over_midnight(&mut times.1, theirs),
                );
                both.0 || both.1
            };
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
                clock: Some(Clock {
                    is_over_midnight,
                    ..clock
                }),
                is_loose: false,
                left_out: None,
                n_robot,
            }))
        }
        _ => {
            let how = match by {
                JoinBy::Number if is_in_names => Names::NumbersIn,
                JoinBy::Number => Names::Numbers,
                _ => Names::Of {
                    loosely: options.loose_names,
                    // In a file without names, numbers are used as names.
                    have_names,
                },
            };
            let found = by_names(robot, ours, theirs, how, options)?;
            Ok(Some(Pairing {
                by,
                pairs: found.pairs,
                clock: None,
                is_loose: found.is_loose,
                left_out: found.left_out,
                n_robot,
            }))
        }
    }
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
        left_out: pairing.left_out.clone(),
        instrument_log: pairing
            .clock
            .as_ref()
            .is_some_and(|clock| clock.instrument_rows.is_some()),
        settled_standstills: false,
        over_midnight: (pairing.clock.as_ref()).is_some_and(|clock| clock.is_over_midnight),
        leftover_robot: (0..robot.points.len())
            .filter(is_leftover)
            .map(|row| leftover(robot, row))
            .collect(),
        leftover_instrument: without.map(|(row, _)| leftover(instrument, row)).collect(),
    }
}
