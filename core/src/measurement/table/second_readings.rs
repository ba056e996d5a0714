//! Unused columns with numbers like those of used columns: a second position in every row, or a second value of every joint. The file does
//! not state which of the two was measured, so the user is asked.

use crate::measurement::columns::mapping::Needs;
use crate::measurement::columns::meaning::{thing, unit};
use crate::measurement::columns::names::{ANGLES, Known, LENGTHS, Unit, name_and_unit, recognise};
use crate::measurement::columns::words::is_one_of;
use crate::measurement::conventions::Decimal;
use crate::measurement::csv::number_text::value;
use crate::measurement::table::Table;
use crate::measurement::table::groups::NOT_MEASURED;
use crate::measurement::table::resolution::Resolution;
use std::collections::BTreeMap;

/// Words in names of columns that are clearly no second measurement, in addition to the words above groups of columns.
const OTHER_WORDS: &str = "robot|rob|flange|cmd|target|set|setpoint|desired|demand|goal|plan|planned|for|theo|theor|err|fehler|differenz|tol|tolerance|\
    toleranz|unc|stdev|stddev|σ|offset|correction|normal|orientation|rotation|rot|quat|quaternion|angle|winkel|vector|velocity|vel|speed|acc|acceleration|\
    force|torque|moment|pixel|px|ref|fit|fitted";
/// Letters before an axis that mean a deviation, an uncertainty, a rotation, a velocity or a force.
const OTHER_LETTERS: &str = "d|δ|∆|u|σ|r|q|v|f";
/// Units that are no units of length.
const OTHER_UNITS: &str = "n|nm|kn|mnm|v|a|g|px|hz|c|k|pulse|pulses|count|counts|inc";
/// Number of rows that are examined.
const SAMPLE: usize = 500;
/// Minimum extent of second positions, as a share of the extent of the positions that are read.
const MIN_EXTENT: f64 = 0.05;
/// Minimum correlation of the distances between successive rows. Positions in another unit or frame are recognised by these distances.
const MIN_CORRELATION: f64 = 0.9;
/// Minimum number of rows for a correlation.
const MIN_ROWS: usize = 5;
/// Two columns are readings of the same joint if they differ by less, degrees.
const SAME_JOINT_DEG: f64 = 5.0;

/// A name without its axis or number: the text before it, and the text after it.
type Around = (String, String);
/// A column with its unit.
type Column = (usize, Option<Unit>);
/// For each name without its axis or number: the columns of all axes or numbers.
type ByName<const N: usize> = BTreeMap<Around, [Option<Column>; N]>;

/// Asks which columns were measured if unused columns have similar numbers. `known` has the meanings of the columns by their names.
pub fn ask_for_second_readings(resolution: &mut Resolution, known: &[(usize, Known)]) {
    let free = |place: &usize| !resolution.taken.contains(place);
    let free: Vec<usize> = (known.iter())
        .filter(|(place, known)| *known == Known::Unknown && free(place))
        .map(|(place, _)| *place)
        .filter(|place| !has_known_name(resolution, *place))
        .collect();
    if resolution.needs_positions() {
        second_positions(resolution, &free);
    }
    if resolution.needs != Needs::Positions {
        second_joints(resolution, &free);
    }
}

/// Whether the name means a position or a joint value. Such a column is unused only because its group was not measured.
fn has_known_name(resolution: &Resolution, place: usize) -> bool {
    let (name, below) = resolution.names()[place];
    matches!(
        recognise(name, below),
        Known::Position(..) | Known::Joint(..)
    )
}

/// The columns that are read for some quantities, with their units. `None` if one of them is from the mapping.
fn read_by_name(
    resolution: &Resolution,
    things: &[String],
) -> Option<Vec<(usize, Option<&'static str>)>> {
    let column = |wanted: &String| {
        let used = resolution.columns.used.iter();
        let used = used.filter(|used| !used.is_mapped);
        let mut used = used.filter(|used| thing(&used.means) == wanted);
        used.next().map(|used| (used.place, unit(&used.means)))
    };
    things.iter().map(column).collect()
}

fn is_other(around: &Around) -> bool {
    let text = format!("{} {}", around.0, around.1);
    let mut words = text.split(|c: char| !c.is_alphanumeric());
    let front = around.0.trim_matches(|c: char| !c.is_alphanumeric());
    words.any(|word| is_one_of(NOT_MEASURED, word) || is_one_of(OTHER_WORDS, word))
        || is_one_of(OTHER_LETTERS, front)
}

/// Whether a name ends with a unit in brackets that is no unit of length.
fn has_other_unit(behind: &str) -> bool {
    let Some((_, inner)) = behind.rsplit_once(['[', '(']) else {
        return false;
    };
    let inner = inner.trim_end_matches([']', ')', ' ']);
    inner.contains(['/', '%']) || is_one_of(OTHER_UNITS, inner.trim())
}

/// Columns whose names contain one of `parts`, by the rest of the name: for each part, a column with its unit.
fn by_name<const N: usize>(
    resolution: &Resolution,
    free: &[usize],
    parts: impl Fn(&str) -> Vec<(usize, std::ops::Range<usize>)>,
) -> ByName<N> {
    let names = resolution.names();
    let mut found: ByName<N> = BTreeMap::new();
    for place in free {
        let (name, below) = names[*place];
        let (base, own) = name_and_unit(name);
        for (part, at) in parts(&base) {
            let around = (base[..at.start].to_owned(), base[at.end..].to_owned());
            let columns = found.entry(around).or_insert([None; N]);
            if let Some(column) = columns.get_mut(part) {
                column.get_or_insert((*place, own.or(below)));
            }
        }
    }
    found
}

/// The places of x, y and z in a name.
fn axes(base: &str) -> Vec<(usize, std::ops::Range<usize>)> {
    let axis = |(at, c): (usize, char)| {
        let axis = ['x', 'y', 'z'].iter().position(|axis| *axis == c)?;
        Some((axis, at..at + 1))
    };
    base.char_indices().filter_map(axis).collect()
}

/// The numbers in a name.
fn numbers(base: &str) -> Vec<(usize, std::ops::Range<usize>)> {
    let mut found = Vec::new();
    let mut at = 0;
    for part in base.split_inclusive(|c: char| !c.is_ascii_digit()) {
        let digits = part.trim_end_matches(|c: char| !c.is_ascii_digit());
        if let Ok(number) = digits.parse() {
            found.push((number, at..at + digits.len()));
        }
        at += part.len();
    }
    found
}

/// The numbers of some columns in the first rows, without rows in which such a cell is no number.
fn values(table: &Table, places: &[usize]) -> Vec<Vec<f64>> {
    let number = |cell: &str| value(cell, Decimal::Point).or_else(|| value(cell, Decimal::Comma));
    let numbers = |row: &Vec<String>| -> Option<Vec<f64>> {
        let cell = |place: &usize| row.get(*place).map_or("", String::as_str);
        places.iter().map(|place| number(cell(place))).collect()
    };
    let rows = table.first_rows(SAMPLE, 2 * SAMPLE);
    rows.iter().filter_map(numbers).collect()
}

fn millimetres(unit: Option<&str>) -> f64 {
    let factor = LENGTHS.iter().find(|(name, _)| Some(*name) == unit);
    factor.map_or(1.0, |(_, factor)| *factor)
}

fn second_positions(resolution: &mut Resolution, free: &[usize]) {
    let things = ["x", "y", "z"].map(str::to_owned);
    let Some(read) = read_by_name(resolution, &things) else {
        return;
    };
    for (around, columns) in by_name::<3>(resolution, free, axes) {
        let [Some(x), Some(y), Some(z)] = columns else {
            continue;
        };
        let length = |unit: Option<Unit>| match unit {
            None => Some(None),
            Some(Unit::Is(unit)) => {
                let known = LENGTHS.iter().find(|(name, _)| *name == unit);
                known.map(|(name, _)| Some(*name))
            }
            Some(_) => None,
        };
        let Some(own) = length(x.1) else { continue };
        if is_other(&around) || has_other_unit(&around.1) {
            continue;
        }
        let mut places: Vec<usize> = read.iter().map(|(place, _)| *place).collect();
        places.extend([x.0, y.0, z.0]);
        let rows = values(resolution.table, &places);
        let scales = [millimetres(read[0].1), millimetres(own.or(read[0].1))];
        if !are_positions(&rows, scales) {
            continue;
        }
        for ((axis, (place, _)), (second, _)) in things.iter().zip(&read).zip([x, y, z]) {
            let unit = own.or(read[0].1).unwrap_or("mm");
            let detail = format!(
                "columns {} and {} may both be {axis}, because both have numbers of positions: say which was measured in the column mapping: \
                 {{\"{axis}_{unit}\": \"COLUMN\"}}; the other is then left aside",
                resolution.table.name(*place),
                resolution.table.name(second)
            );
            let name = resolution.table.name(second);
            resolution.issue(Some(name), "duplicate_column", detail);
        }
        return;
    }
}

/// Whether the last three numbers of each row are positions like the first three. `scales` are their units in mm.
fn are_positions(rows: &[Vec<f64>], scales: [f64; 2]) -> bool {
    let extent = |first: usize| -> f64 {
        let of_axis = |axis: usize| {
            let values = rows.iter().map(|row| row[first + axis]);
            let (least, largest) = values.fold(
                (f64::INFINITY, f64::NEG_INFINITY),
                |(least, largest), value| (least.min(value), largest.max(value)),
            );
            square(largest - least)
        };
        (of_axis(0) + of_axis(1) + of_axis(2)).sqrt()
    };
    if rows.len() < 2 {
        return false;
    }
    let share = extent(3) * scales[1] / (extent(0) * scales[0]);
    (MIN_EXTENT..1.0 / MIN_EXTENT).contains(&share)
        || rows.len() >= MIN_ROWS && correlation(&steps(rows, 0), &steps(rows, 3)) > MIN_CORRELATION
}

/// The distances between successive rows.
fn steps(rows: &[Vec<f64>], first: usize) -> Vec<f64> {
    let step = |pair: &[Vec<f64>]| {
        let axes = (first..first + 3).map(|at| square(pair[1][at] - pair[0][at]));
        axes.sum::<f64>().sqrt()
    };
    rows.windows(2).map(step).collect()
}

fn square(value: f64) -> f64 {
    value * value
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let product: f64 = (a.iter().zip(b))
        .map(|(a, b)| (a - mean_a) * (b - mean_b))
        .sum();
    let squares = |values: &[f64], mean: f64| -> f64 {
        values.iter().map(|value| square(value - mean)).sum()
    };
    product / (squares(a, mean_a) * squares(b, mean_b)).sqrt()
}

/// Maximum number of joints with a second column.
const MAX_JOINTS: usize = 13;

fn second_joints(resolution: &mut Resolution, free: &[usize]) {
    let n = resolution.n_joints;
    let things: Vec<String> = (1..=n).map(|joint| format!("q{joint}")).collect();
    let Some(read) = read_by_name(resolution, &things).filter(|_| n < MAX_JOINTS) else {
        return;
    };
    for (around, columns) in by_name::<MAX_JOINTS>(resolution, free, numbers) {
        // Joints may be counted from 0 or from 1.
        let counted = [&columns[..n], &columns[1..=n]];
        let whole = counted
            .into_iter()
            .find_map(|columns| columns.iter().copied().collect::<Option<Vec<_>>>());
        let Some(second) = whole.filter(|_| !is_other(&around)) else {
            continue;
        };
        let mut places: Vec<usize> = read.iter().map(|(place, _)| *place).collect();
        places.extend(second.iter().map(|(place, _)| place));
        let rows = values(resolution.table, &places);
        let degrees = |unit: Option<&str>| {
            let factor = ANGLES.iter().find(|(name, _)| Some(*name) == unit);
            factor.map_or(1.0, |(_, factor)| factor.to_degrees())
        };
        let own = degrees(read[0].1);
        let others = match second[0].1 {
            Some(Unit::Is(unit)) if ANGLES.iter().any(|(name, _)| *name == unit) => {
                vec![degrees(Some(unit))]
            }
            None | Some(Unit::Missing | Unit::TwoReadings) => vec![1.0, degrees(Some("rad"))],
            Some(Unit::Is(_)) => continue,
        };
        let agrees = |other: &f64| {
            let pair = |row: &Vec<f64>, at: usize| (row[at] * own - row[n + at] * other).abs();
            rows.iter()
                .all(|row| (0..n).all(|at| pair(row, at) < SAME_JOINT_DEG))
        };
        if rows.is_empty() || !others.iter().any(agrees) {
            continue;
        }
        for ((joint, (place, unit)), (second, _)) in things.iter().zip(&read).zip(second) {
            let detail = format!(
                "columns {} and {} may both be {joint}, one as commanded and one as measured: say which the robot had in the column mapping: \
                 {{\"{joint}_{}\": \"COLUMN\"}}; the other is then left aside",
                resolution.table.name(*place),
                resolution.table.name(second),
                unit.unwrap_or("deg")
            );
            let name = resolution.table.name(second);
            resolution.issue(Some(name), "duplicate_column", detail);
        }
        return;
    }
}

#[cfg(test)]
mod tests {
    use super::{axes, numbers};

    #[test]
    fn axes_and_numbers_are_found_in_names() {
        assert_eq!(axes("at960 x"), [(0, 6..7)]);
        assert_eq!(axes("max y"), [(0, 2..3), (1, 4..5)]);
        assert_eq!(numbers("fb_j12 m3"), [(12, 4..6), (3, 8..9)]);
        assert_eq!(numbers("x"), []);
    }
}
