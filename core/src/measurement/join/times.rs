//! Times in cells: numbers with the unit of their column, times of day, and dates.

use crate::measurement::columns::meaning::key;
use crate::measurement::columns::names::{Key, TimeUnit};
use crate::measurement::join::options::{JoinError, error};

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

/// A time of day that falls back by more than this is one of the next day, s (20 h).
const NEXT_DAY_S: f64 = 72_000.0;

/// Counts times of day on over midnight. Returns whether there was one. Times with a date and numbers do not fall back so far in a file that is in order.
pub fn over_midnight(times_s: &mut [f64], cells: &[String]) -> bool {
    let are_of_day = cells
        .iter()
        .all(|cell| cell.contains(':') && !cell.contains(['T', '-', '/']));
    let (mut before_s, mut day_s) = (f64::NEG_INFINITY, 0.0);
    for time_s in times_s.iter_mut().filter(|_| are_of_day) {
        if before_s - *time_s > NEXT_DAY_S {
            day_s += 86_400.0;
        }
        before_s = *time_s;
        *time_s += day_s;
    }
    day_s > 0.0
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

#[cfg(test)]
mod tests {
    use super::{TimeUnit, over_midnight, seconds};

    #[test]
    fn times_of_day_go_on_over_midnight() {
        let read = |cells: [&str; 3]| {
            let cells = cells.map(str::to_owned);
            let times = cells
                .iter()
                .map(|cell| seconds(cell, TimeUnit::Unstated).unwrap());
            let mut times: Vec<f64> = times.collect();
            (over_midnight(&mut times, &cells), times)
        };
        assert_eq!(
            read(["23:59:59", "0:00:01", "0:00:03"]),
            (true, vec![86_399.0, 86_401.0, 86_403.0])
        );
        assert_eq!(
            read(["10:00:00", "9:00:00", "11:00:00"]),
            (false, vec![36_000.0, 32_400.0, 39_600.0])
        );
    }

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
