//! Pairs rows of two files by time. If the difference between the two clocks is not stated, it is found from the pattern of the times.

use crate::measurement::columns::meaning::key;
use crate::measurement::columns::names::{Key, TimeUnit};
use crate::measurement::join::clock::{Standstill, found_offset, paired, refuse_wrong_offset};
use crate::measurement::join::options::{JoinBy, JoinError, JoinOptions, Pairs, error};
use crate::measurement::set::{Point, SAME_JOINT_RAD};
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// If the median time between rows is at most this, the file is a continuous log and was not written pose by pose, s.
const LOG_SPACING_S: f64 = 0.5;
/// Minimum number of rows of a standstill in a log.
const MIN_STANDSTILL_ROWS: usize = 3;
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
    /// If the instrument's file is a log: the rows that represent its standstills.
    pub instrument_rows: Option<BTreeSet<usize>>,
}

/// Times of a column, s.
///
/// # Errors
/// `not_a_time` with the line of a cell that is not a time.
pub fn times(
    means: &str,
    cells: &[String],
    lines: &[usize],
    file: &str,
) -> Result<Vec<f64>, JoinError> {
    let unit = match key(means) {
        Some(Key::Time(unit)) => unit,
        _ => TimeUnit::Unstated,
    };
    // In a date with slashes the day or the month may come first. This does not matter if all rows have the same date: the date is then left out.
    let date = cells.first().and_then(|cell| slashed_date(cell));
    let date = date.filter(|date| cells.iter().all(|cell| slashed_date(cell) == Some(*date)));
    let read = |(cell, line): (&String, &usize)| {
        let of_day = date.map_or(cell.as_str(), |date| &cell.trim()[date.len()..]);
        seconds(of_day, unit).ok_or_else(|| {
            let what = match cell.replace(',', ".").parse::<f64>() {
                Ok(_) => format!(
                    "has no unit: call the column time [s] or time [ms], or say it in the column mapping: \
                     {{\"{file}\": {{\"time_s\": \"COLUMN\"}}}} (milliseconds are time_ms)"
                ),
                Err(_) if slashed_date(cell).is_some() => {
                    "has a date with slashes, of which the day or the month may come first: write 2026-03-01T08:15:30".into()
                }
                Err(_) => "is not a time: 12.5 under time [s], 08:15:30.250 or 2026-03-01T08:15:30Z".to_owned(),
            };
            error("not_a_time", format!("{file} file, line {line}: {cell:?} {what}"))
        })
    };
    cells.iter().zip(lines).map(read).collect()
}

/// A date with slashes, such as `3/1/2026`, before a time.
fn slashed_date(cell: &str) -> Option<&str> {
    let (date, _) = cell.trim().split_once(' ')?;
    let is_date =
        date.matches('/').count() == 2 && date.bytes().all(|b| b == b'/' || b.is_ascii_digit());
    is_date.then_some(date)
}

/// Splits off AM or PM. Returns the time without it, and the hours to add.
fn without_half_day(cell: &str) -> (&str, Option<f64>) {
    let halves = [("am", 0.0), ("a.m.", 0.0), ("pm", 12.0), ("p.m.", 12.0)];
    for (mark, hours) in halves {
        let at = cell.len().saturating_sub(mark.len());
        if cell
            .get(at..)
            .is_some_and(|end| end.eq_ignore_ascii_case(mark))
        {
            return (cell[..at].trim_end(), Some(hours));
        }
    }
    (cell, None)
}

/// Converts a cell to seconds: a number with the unit of its column, a time of day, or a date with a time of day.
fn seconds(cell: &str, unit: TimeUnit) -> Option<f64> {
    let cell = cell.trim();
    if let Ok(number) = cell.replace(',', ".").parse::<f64>() {
        return (number.is_finite() && unit != TimeUnit::Unstated).then(|| number * unit.seconds());
    }
    let (cell, half_day) = without_half_day(cell);
    let (date, time) = match cell.split_once(['T', ' ']) {
        Some((date, time)) => (days(date)?, time.trim()),
        None => (0.0, cell),
    };
    let (time, zone_s) = without_zone(time)?;
    let mut parts = time.split(':');
    let mut part = |limit: f64| {
        let text = parts.next()?;
        let is_plain = text
            .bytes()
            .all(|byte| byte.is_ascii_digit() || byte == b'.' || byte == b',');
        let value: f64 = text.replace(',', ".").parse().ok().filter(|_| is_plain)?;
        (value < limit).then_some(value)
    };
    let (hours, minutes) = (part(24.0)?, part(60.0)?);
    let hours = match half_day {
        Some(half) if (1.0..=12.0).contains(&hours) => hours % 12.0 + half,
        Some(_) => return None,
        None => hours,
    };
    let rest = match time.matches(':').count() {
        1 => 0.0,
        2 => part(61.0)?,
        _ => return None,
    };
    Some(date * 86_400.0 + hours * 3600.0 + minutes * 60.0 + rest - zone_s)
}

fn without_zone(time: &str) -> Option<(&str, f64)> {
    if let Some(time) = time.strip_suffix(['Z', 'z']) {
        return Some((time, 0.0));
    }
    let Some(at) = time.rfind(['+', '-']) else {
        return Some((time, 0.0));
    };
    let (hours, minutes) = time[at + 1..].split_once(':')?;
    let (hours, minutes): (f64, f64) = (hours.parse().ok()?, minutes.parse().ok()?);
    let sign = if time.as_bytes()[at] == b'-' {
        -1.0
    } else {
        1.0
    };
    Some((&time[..at], sign * (hours * 3600.0 + minutes * 60.0)))
}

/// Days since 1970-01-01 of a date such as 2026-03-01 or 01.03.2026. A date with slashes is ambiguous and not accepted here.
fn days(date: &str) -> Option<f64> {
    let numbers = |separator: char| -> Option<[i64; 3]> {
        let parts: Vec<i64> = date
            .split(separator)
            .map(|part| part.parse().ok())
            .collect::<Option<_>>()?;
        parts.try_into().ok()
    };
    let [year, month, day] = match (date.contains('-'), date.contains('.')) {
        (true, false) => numbers('-')?,
        (false, true) => numbers('.').map(|[day, month, year]| [year, month, day])?,
        _ => return None,
    };
    if !(1970..=2200).contains(&year) || !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    // Algorithm `days_from_civil` of Howard Hinnant, in which years begin in March.
    let y = if month <= 2 { year - 1 } else { year };
    let (era, m) = (y.div_euclid(400), (month + 9) % 12);
    let year_of_era = y - era * 400;
    let day_of_year = (153 * m + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    Some((era * 146_097 + day_of_era - 719_468) as f64)
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
    let standstills = standstills(robot, robot_s);
    if standstills.is_empty() {
        return Err(error(
            "join_unclear",
            "the robot's file has no standstill: it moves in every row",
        ));
    }
    let tolerance_s = options
        .tolerance_s
        .unwrap_or_else(|| tolerance(&standstills));
    let is_log = options
        .instrument_log
        .unwrap_or_else(|| is_log(&in_order(instrument_s), instrument_s));
    let rows: Vec<usize> = match is_log {
        true => instrument_standstills(instrument, instrument_s),
        false => (0..instrument.len()).collect(),
    };
    let wanted_s: Vec<f64> = rows.iter().map(|row| instrument_s[*row]).collect();
    let offset_s = match options.clock_offset_s {
        Some(offset_s) => offset_s,
        None => found_offset(&standstills, &wanted_s, tolerance_s)?,
    };
    let matched = paired(&standstills, &wanted_s, offset_s, tolerance_s);
    if options.clock_offset_s.is_some() {
        let is_by_time = options.by == Some(JoinBy::Time);
        refuse_wrong_offset(&standstills, &wanted_s, offset_s, tolerance_s, is_by_time)?;
    }
    let mut pairs: Pairs = vec![None; instrument.len()];
    for (row, pair) in rows.iter().zip(matched) {
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
            instrument_rows: is_log.then(|| rows.into_iter().collect()),
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

/// The row in the middle of each standstill in an instrument's log. In a standstill all positions are within [`MAX_APART`] of the points' extent.
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

/// The standstills of the robot, in the order of time: consecutive rows in which no joint moves.
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

#[cfg(test)]
mod tests {
    use super::{TimeUnit, seconds};

    #[test]
    fn times_are_read_in_seconds() {
        let plain = |cell| seconds(cell, TimeUnit::Unstated);
        assert_eq!(seconds("12,5", TimeUnit::Milliseconds), Some(0.0125));
        assert_eq!(plain("12.5"), None);
        assert_eq!(plain("01:00:02.5"), Some(3602.5));
        assert_eq!(plain("12:30:00 AM"), Some(1800.0));
        assert_eq!(plain("1970-01-02 1:00:00.5 pm"), Some(133_200.5));
        assert_eq!(plain("13:00:00 PM"), None);
        assert_eq!(plain("1970-01-02T00:00:01Z"), Some(86_401.0));
        assert_eq!(plain("2000-03-01 00:00"), Some(951_868_800.0));
        assert_eq!(plain("01.03.2000 01:00:00+01:00"), Some(951_868_800.0));
        for bad in [
            "03/01/2000 08:00:00",
            "25:00:00",
            "noon",
            "",
            "1:2:3:4",
            "-1:00:00",
        ] {
            assert_eq!(plain(bad), None, "{bad}");
        }
    }
}
