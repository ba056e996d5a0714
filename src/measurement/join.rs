//! Joins the robot's file and the instrument's: which joint values belong to which position, by name, number, time or order.

use crate::measurement::column_meaning::key;
use crate::measurement::column_names::Key;
use crate::measurement::join_options::{Pairs, error};
use crate::measurement::join_time::{Clock, by_time, times};
use crate::measurement::set::{Point, SAME_JOINT_RAD};
use crate::measurement::table_points::Content;
use std::collections::{BTreeMap, BTreeSet};

pub use crate::measurement::join_options::{JoinBy, JoinError, JoinOptions};

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
    /// What paired the rows.
    pub by: JoinBy,
    /// Pairs.
    pub n_joined: usize,
    /// By time: how far apart a pair's times may be, s.
    pub tolerance_s: Option<f64>,
    /// By time: the robot's clock minus the instrument's, s.
    pub clock_offset_s: Option<f64>,
    /// Rows of the robot's file without a partner.
    pub leftover_robot: Vec<Leftover>,
    /// Rows of the instrument's file without a partner.
    pub leftover_instrument: Vec<Leftover>,
}

/// One way of pairing.
#[derive(Clone, Debug)]
struct Pairing {
    by: JoinBy,
    pairs: Pairs,
    clock: Option<Clock>,
    /// Rows of the robot's file that need no partner: it moves in them, or stands where a partner was found.
    n_robot: usize,
}

impl Pairing {
    fn n_joined(&self) -> usize {
        self.pairs.iter().flatten().count()
    }

    /// Whether it pairs most of what can be paired.
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

/// Joins the two files: the positions in their order, each with its joint values.
///
/// # Errors
/// [`JoinError`] if nothing pairs the rows, or they can be paired in two ways.
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
                return Err(error(
                    "join_unclear",
                    format!(
                        "both files need a column for join by {}: name it by ?columns= (--columns), {{\"robot\": {{\"{0}\": …}}, \"instrument\": \
                         {{\"{0}\": …}}}}",
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
        return Err(why.unwrap_or_else(|| {
            error(
                "join_unclear",
                "nothing pairs the rows of the two files: both need a column with the points' names, numbers or times that agree. Name them by \
                 ?columns= (--columns), {\"robot\": {\"name\": …}, \"instrument\": {\"name\": …}}, or state \"join\": {\"by\": \"order\"} if row \
                 belongs to row",
            )
        }));
    };
    if let Some(other) = usable.iter().find(|other| other.contradicts(best, robot)) {
        return Err(error(
            "two_readings",
            format!(
                "the rows pair in one way by {} and in another by {}: state which in ?columns= (--columns), \"join\": {{\"by\": \"{0}\"}}",
                best.by.as_str(),
                other.by.as_str()
            ),
        ));
    }
    Ok((
        points(robot, instrument, &best.pairs),
        summary(robot, instrument, best),
    ))
}

fn points(robot: &Content, instrument: &Content, pairs: &Pairs) -> Vec<Point> {
    let paired = instrument.points.iter().zip(pairs);
    paired
        .filter_map(|(point, pair)| {
            Some(Point {
                q_rad: robot.points[(*pair)?].q_rad.clone(),
                ..point.clone()
            })
        })
        .collect()
}

/// The cells of a key's column.
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
            n_robot,
        }))
    };
    if by == JoinBy::Order {
        let (a, b) = (n_robot, instrument.points.len());
        if a != b {
            let detail = format!(
                "the robot's file has {a} rows and the instrument's {b}: by order they do not pair"
            );
            return Err(error("join_unclear", detail));
        }
        return plain((0..a).map(Some).collect());
    }
    let (Some((means, ours)), Some((their_means, theirs))) =
        (cells(robot, by), cells(instrument, by))
    else {
        return Ok(None);
    };
    match by {
        JoinBy::Time => {
            let times = (
                times(means, ours, &robot.lines, "robot")?,
                times(their_means, theirs, &instrument.lines, "instrument")?,
            );
            let (pairs, clock) = by_time(&robot.points, &times.0, &times.1, options)?;
            let n_robot = clock.n_standstills;
            Ok(Some(Pairing {
                by,
                pairs,
                clock: Some(clock),
                n_robot,
            }))
        }
        JoinBy::Number => plain(by_label(robot, ours, theirs, &[number])?),
        _ => plain(by_label(robot, ours, theirs, &[exact, lower, last_part])?),
    }
}

fn exact(label: &str) -> String {
    label.to_owned()
}

fn lower(label: &str) -> String {
    label.to_lowercase()
}

/// The point's own name in one like `collection::group::P1`.
fn last_part(label: &str) -> String {
    let lower = label.to_lowercase();
    let last = lower.rsplit("::").next().unwrap_or_default();
    last.trim().to_owned()
}

/// A number, however many zeros are in front of it.
fn number(label: &str) -> String {
    label
        .parse::<f64>()
        .map_or_else(|_| label.to_owned(), |number| number.to_string())
}

/// Pairs rows of the same label, in the form that pairs the most.
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
        // a form that makes one of two names is no better
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
    let label = |content: &Content, row: usize| {
        let cells = cells(content, pairing.by).map(|(_, cells)| cells);
        cells
            .and_then(|cells| cells.get(row))
            .cloned()
            .unwrap_or_default()
    };
    let is_leftover = |row: &usize| match &pairing.clock {
        // a log has many rows of one standstill, and rows in which the robot moves
        Some(clock) => clock.standstills.contains(row) && !taken.contains(row),
        None => !taken.contains(row),
    };
    let leftover = |content: &Content, row: usize| Leftover {
        line: content.lines[row],
        label: label(content, row),
    };
    let without = pairing
        .pairs
        .iter()
        .enumerate()
        .filter(|(_, pair)| pair.is_none());
    Join {
        by: pairing.by,
        n_joined: pairing.n_joined(),
        tolerance_s: pairing.clock.as_ref().map(|clock| clock.tolerance_s),
        clock_offset_s: pairing.clock.as_ref().map(|clock| clock.offset_s),
        leftover_robot: (0..robot.points.len())
            .filter(is_leftover)
            .map(|row| leftover(robot, row))
            .collect(),
        leftover_instrument: without.map(|(row, _)| leftover(instrument, row)).collect(),
    }
}
