//! Pairs rows of two files by time. If the difference between the two clocks is not stated, it is found from the pattern of the times.

use crate::measurement::join::clock::{
    Standstill, clocks_cannot_be_compared, offset_from_times, paired, stated_or_found,
};
use crate::measurement::join::logs::{offset_and_pairs, together};
use crate::measurement::join::options::{JoinError, JoinOptions, Pairs, n_paired};
use crate::measurement::join::standstills::{Log, MIN_STANDSTILL_ROWS, largest_difference, length};
use crate::measurement::set::{Point, SAME_JOINT_RAD};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// If the median time between rows is at most this, the file is a continuous log and was not written pose by pose, s.
const LOG_SPACING_S: f64 = 0.5;
/// Largest tolerance that is chosen automatically, s. An instrument measures some seconds after the robot has stopped.
const MAX_TOLERANCE_S: f64 = 5.0;

/// Positions of one posture are within this share of the points' extent. It is ten times the deviation of a robot that returns to a posture.
pub const MAX_APART: f64 = 1.0e-3;

/// Extent of the points, mm: median distance of the positions from the first one.
pub fn extent_mm(positions_mm: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let all: Vec<Vector3<f64>> = positions_mm.collect();
    let mut far: Vec<f64> = all
        .iter()
        .map(|position| (position - all[0]).norm())
        .collect();
    far.sort_by(f64::total_cmp);
    far.get(far.len() / 2).copied().unwrap_or(0.0)
}

/// Result of the comparison of the two clocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    pub offset_s: f64,
    pub tolerance_s: f64,
    /// The row of the robot's file that represents each standstill.
    pub standstills: Vec<usize>,
    pub n_standstills: usize,
    /// Whether times of day went on over midnight.
    pub is_over_midnight: bool,
    /// If the instrument's file is a log: the rows that represent its standstills.
    pub instrument_rows: Option<BTreeSet<usize>>,
}

/// Pairs positions with standstills of the robot.
///
/// # Errors
/// `join_unclear` if the clock difference cannot be found, `two_readings` if two clock differences are possible.
pub fn by_time(
    robot: &[Point],
    robot_s: &[f64],
    instrument: &[Point],
    instrument_s: &[f64],
    options: &JoinOptions,
) -> Result<(Pairs, Clock), JoinError> {
    let order = in_order(robot_s);
    let log = is_log(&order, robot_s).then(|| log_of_robot(robot, robot_s, &order));
    let standstills = match &log {
        Some(log) if options.settled_standstills => log.standstills(),
        _ => standstills(robot, robot_s),
    };
    if standstills.is_empty() {
        return Err(clocks_cannot_be_compared(
            "the robot's file has no standstill: it moves in every row, and only what was measured while it stands can be used",
        ));
    }
    let is_instrument_log = options
        .instrument_log
        .unwrap_or_else(|| is_log(&in_order(instrument_s), instrument_s));
    if is_instrument_log && options.settled_standstills {
        let theirs = log_of_instrument(instrument, instrument_s);
        return of_logs(&standstills, log.as_ref(), &theirs, options);
    }
    let tolerance_s = options
        .tolerance_s
        .unwrap_or_else(|| tolerance(&standstills));
    let rows: Vec<usize> = match is_instrument_log {
        true => instrument_standstills(instrument, instrument_s),
        false => (0..instrument.len()).collect(),
    };
    let wanted_s: Vec<f64> = rows.iter().map(|row| instrument_s[*row]).collect();
    let matched = |offset_s| paired(&standstills, &wanted_s, offset_s, tolerance_s);
    let offset_s = stated_or_found(
        options,
        tolerance_s,
        wanted_s.len().min(standstills.len()),
        |offset_s| n_paired(&matched(offset_s)),
        || offset_from_times(&standstills, &wanted_s, tolerance_s),
    )?;
    let mut pairs: Pairs = vec![None; instrument.len()];
    for (row, pair) in rows.iter().zip(matched(offset_s)) {
        pairs[*row] = pair.map(|at| standstills[at].row);
    }
    Ok((
        pairs,
        Clock {
            offset_s,
            tolerance_s,
            standstills: standstills
                .iter()
                .map(|standstill| standstill.row)
                .collect(),
            n_standstills: standstills.len(),
            is_over_midnight: false,
            instrument_rows: is_instrument_log.then(|| rows.into_iter().collect()),
        },
    ))
}

fn log_of_robot(robot: &[Point], robot_s: &[f64], order: &[usize]) -> Log {
    Log {
        rows: order.iter().map(|row| (*row, robot_s[*row])).collect(),
        values: order.iter().map(|row| robot[*row].q_rad.clone()).collect(),
        limit: SAME_JOINT_RAD,
        distance: largest_difference,
    }
}

fn log_of_instrument(instrument: &[Point], instrument_s: &[f64]) -> Log {
    let order = in_order(instrument_s);
    let position = |row: &usize| instrument[*row].position_mm.iter().copied().collect();
    Log {
        rows: order.iter().map(|row| (*row, instrument_s[*row])).collect(),
        values: order.iter().map(position).collect(),
        limit: MAX_APART * extent_mm(instrument.iter().map(|point| point.position_mm)),
        distance: length,
    }
}

/// Pairs the standstills of an instrument's log with those of the robot: the rows in the middle of the time in which both stand. `log` is the robot's
/// file, if that is a log, too.
fn of_logs(
    ours: &[Standstill],
    log: Option<&Log>,
    instrument: &Log,
    options: &JoinOptions,
) -> Result<(Pairs, Clock), JoinError> {
    let theirs = instrument.standstills();
    if theirs.is_empty() {
        return Err(clocks_cannot_be_compared(
            "the instrument's file has no standstill: its positions move in every row",
        ));
    }
    // A robot that wrote one row per pose may have written it just before or after the standstill, if the clock difference is not exact.
    let tolerance_s = match (options.tolerance_s, log, options.clock_offset_s) {
        (Some(stated_s), ..) => stated_s,
        (None, None, Some(_)) => tolerance(ours),
        _ => 0.0,
    };
    let (offset_s, matched) = offset_and_pairs(ours, &theirs, options, tolerance_s)?;
    let mut pairs: Pairs = vec![None; instrument.rows.len()];
    let mut robot_rows: Vec<usize> = ours.iter().map(|own| own.row).collect();
    let mut instrument_rows = BTreeSet::new();
    for (one, pair) in theirs.iter().zip(matched) {
        let Some(at) = pair else {
            instrument_rows.insert(one.row);
            continue;
        };
        let [from_s, to_s] = together(&ours[at], one, offset_s);
        let middle_s = (from_s + to_s) / 2.0;
        let (own, row) = match from_s <= to_s {
            true => (
                log.map_or(ours[at].row, |log| log.row_at(middle_s)),
                instrument.row_at(middle_s - offset_s),
            ),
            false => (ours[at].row, one.row),
        };
        robot_rows[at] = own;
        pairs[row] = Some(own);
        instrument_rows.insert(row);
    }
    Ok((
        pairs,
        Clock {
            offset_s,
            tolerance_s,
            standstills: robot_rows,
            n_standstills: ours.len(),
            is_over_midnight: false,
            instrument_rows: Some(instrument_rows),
        },
    ))
}

/// Row indices sorted by time.
fn in_order(times_s: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..times_s.len()).collect();
    order.sort_by(|a, b| times_s[*a].total_cmp(&times_s[*b]));
    order
}

/// Whether the file is a log: its rows follow each other faster than poses are measured one by one.
fn is_log(order: &[usize], times_s: &[f64]) -> bool {
    let mut spacings: Vec<f64> = order
        .windows(2)
        .map(|w| times_s[w[1]] - times_s[w[0]])
        .collect();
    spacings.sort_by(f64::total_cmp);
    let median = spacings.get(spacings.len() / 2);
    median.is_some_and(|s| *s <= LOG_SPACING_S)
}

/// The row in the middle of each standstill in an instrument's log, as earlier versions found them. In a standstill all positions are within [`MAX_APART`] of the points' extent.
fn instrument_standstills(instrument: &[Point], instrument_s: &[f64]) -> Vec<usize> {
    let order = in_order(instrument_s);
    let limit_mm = MAX_APART * extent_mm(instrument.iter().map(|point| point.position_mm));
    let mut found: Vec<Vec<usize>> = Vec::new();
    for row in order {
        let apart_mm =
            |first: usize| (instrument[row].position_mm - instrument[first].position_mm).norm();
        match found
            .last_mut()
            .filter(|rows| apart_mm(rows[0]) <= limit_mm)
        {
            Some(rows) => rows.push(row),
            None => found.push(vec![row]),
        }
    }
    let long = found
        .into_iter()
        .filter(|rows| rows.len() >= MIN_STANDSTILL_ROWS);
    long.map(|rows| rows[rows.len() / 2]).collect()
}

/// The standstills of the robot, in the order of time: consecutive rows in which no joint moves. In a log, as earlier versions found them.
fn standstills(robot: &[Point], robot_s: &[f64]) -> Vec<Standstill> {
    let order = in_order(robot_s);
    let is_log = is_log(&order, robot_s);
    let mut found: Vec<Vec<usize>> = Vec::new();
    for row in order {
        let stands = |first: usize| {
            let mut joints = robot[first].q_rad.iter().zip(&robot[row].q_rad);
            joints.all(|(a, b)| (a - b).abs() < SAME_JOINT_RAD)
        };
        match found.last_mut().filter(|rows| stands(rows[0])) {
            Some(rows) => rows.push(row),
            None => found.push(vec![row]),
        }
    }
    found
        .into_iter()
        .filter(|rows| !is_log || rows.len() >= MIN_STANDSTILL_ROWS)
        .map(|rows| Standstill {
            from_s: robot_s[rows[0]],
            to_s: robot_s[rows[rows.len() - 1]],
            row: rows[rows.len() / 2],
        })
        .collect()
}

/// The tolerance to use if none is stated: a quarter of the shortest time between two standstills, at most [`MAX_TOLERANCE_S`].
fn tolerance(standstills: &[Standstill]) -> f64 {
    let gaps = standstills
        .windows(2)
        .map(|pair| pair[1].from_s - pair[0].to_s);
    (gaps.fold(f64::INFINITY, f64::min) / 4.0).clamp(0.0, MAX_TOLERANCE_S)
}
