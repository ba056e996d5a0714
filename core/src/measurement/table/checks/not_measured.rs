//! Finds values that cannot be measured positions or joint values.

use crate::measurement::csv::PULSES;
use crate::measurement::issue::Issue;
use crate::measurement::set::Point;

/// At most one joint of a robot usually has values beyond this, rad: two turns.
const SEVERAL_TURNS_RAD: f64 = 4.0 * std::f64::consts::PI;
/// Number of joints beyond that limit from which on the values are no angles.
const MANY_JOINTS: usize = 3;

/// The text of a position that stands for a missing measurement. There are three kinds: all coordinates are zero; all are the same whole
/// number (−1) although most rows have decimals; or one is a number such as −9999 (or 9999.9) that is further away than the range of the
/// others. `coordinates` are as written in the file. `others` are the smallest and largest values of each coordinate, without such numbers.
fn missing_value_text(
    coordinates: &[f64; 3],
    others: &[(f64, f64); 3],
    have_decimals: bool,
) -> Option<String> {
    let [first, ..] = *coordinates;
    let are_same = coordinates.iter().all(|value| *value == first);
    if are_same && (first == 0.0 || have_decimals && first.fract() == 0.0) {
        return Some(format!("{first}, {first}, {first}"));
    }
    let is_outside = |(value, (least, largest)): &(&f64, &(f64, f64))| {
        let apart = largest - least;
        no_value(**value) && (**value < least - apart || **value > largest + apart)
    };
    let found = coordinates.iter().zip(others).find(is_outside);
    found.map(|(value, _)| format!("{value}"))
}

/// Whether instruments and programs write this number for a missing value: only nines (−9999, 99999.9), or the limits of 16 bits.
fn no_value(value: f64) -> bool {
    let size = value.abs();
    let is_nines = || format!("{size}").chars().all(|c| matches!(c, '9' | '.'));
    matches!(size, 32_767.0 | 32_768.0) || size >= 9999.0 && is_nines()
}

/// Refuses positions that were not measured. `millimetres` is the unit of each coordinate in the file.
pub fn not_measured(points: &[Point], millimetres: [f64; 3]) -> Vec<Issue> {
    let found = rows_not_measured(points, millimetres);
    let others = match found.len() {
        1 => String::new(),
        n => format!(", as in {n} rows"),
    };
    let issue = |(at, position): (usize, String)| {
        let detail = format!(
            "row {at}: the position is {position}{others}: so instruments write what they have not measured; remove such rows, or put # before them"
        );
        Issue::new("not_measured", detail).in_row(at)
    };
    found.into_iter().map(issue).collect()
}

fn rows_not_measured(points: &[Point], millimetres: [f64; 3]) -> Vec<(usize, String)> {
    let written = |point: &Point| -> [f64; 3] {
        // Dividing and multiplying by a unit may change the last bit.
        std::array::from_fn(|axis| {
            (point.position_mm[axis] / millimetres[axis] * 1e6).round() / 1e6
        })
    };
    let written: Vec<[f64; 3]> = points.iter().map(written).collect();
    let others: [(f64, f64); 3] = std::array::from_fn(|axis| {
        let values = written.iter().map(|row| row[axis]);
        let values = values.filter(|value| !no_value(*value));
        values.fold(
            (f64::INFINITY, f64::NEG_INFINITY),
            |(least, largest), value| (least.min(value), largest.max(value)),
        )
    });
    let has_decimals = |row: &&[f64; 3]| row.iter().any(|value| value.fract() != 0.0);
    let have_decimals = 2 * written.iter().filter(has_decimals).count() > written.len();
    let rows = written.iter().enumerate();
    rows.filter_map(|(at, row)| Some((at, missing_value_text(row, &others, have_decimals)?)))
        .collect()
}

/// Refuses joint values that are no angles.
pub fn pulses(points: &[Point]) -> Vec<Issue> {
    let n_joints = points.first().map_or(0, |point| point.q_rad.len());
    let turned = |joint: usize| {
        let is_turned = |point: &Point| point.q_rad[joint].abs() > SEVERAL_TURNS_RAD;
        Some((joint, points.iter().position(is_turned)?))
    };
    let turned: Vec<(usize, usize)> = (0..n_joints).filter_map(turned).collect();
    let Some((joint, row)) = turned.first().copied() else {
        return vec![];
    };
    let detail = format!(
        "row {row}: joint {} is at {:.0}°, and {} joints turn more than twice: {PULSES}",
        joint + 1,
        points[row].q_rad[joint].to_degrees(),
        turned.len()
    );
    match turned.len() >= MANY_JOINTS {
        true => vec![Issue::new("out_of_range", detail).in_row(row)],
        false => vec![],
    }
}
