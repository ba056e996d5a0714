//! External axes in a table of joint values, such as a track under the robot. They are not read; a table is refused if one of them moves between its rows.

use crate::measurement::columns::names::{LENGTHS, Unit, name_and_unit};
use crate::measurement::conventions::Decimal;
use crate::measurement::csv::number_text::value;
use crate::measurement::issue::Issue;
use crate::measurement::table::{Next, Table};
use std::ops::RangeInclusive;

/// An axis moves if its values differ by more than this, mm or degrees. As for programs.
const STANDSTILL: f64 = 0.05;

/// Whether a column has an external axis by its name: `E1`, `EXTAX`, `eax_a`, or an axis beyond the robot's that is a length.
fn is_external(name: &str, below: Option<Unit>, n_joints: usize) -> bool {
    let (base, unit) = name_and_unit(name);
    let plain: String = base.chars().filter(|c| c.is_alphanumeric()).collect();
    let number = |begin: &str| -> Option<usize> { plain.strip_prefix(begin)?.parse().ok() };
    let begins_with = |begins: &[&str], numbers: RangeInclusive<usize>| {
        begins
            .iter()
            .any(|begin| number(begin).is_some_and(|n| numbers.contains(&n)))
    };
    let is_length = |unit: Unit| LENGTHS.iter().any(|(name, _)| unit == Unit::Is(name));
    matches!(plain.as_str(), "extax" | "externalaxis" | "externalaxes")
        || plain
            .strip_prefix("eax")
            .is_some_and(|axis| matches!(axis, "a" | "b" | "c" | "d" | "e" | "f"))
        || begins_with(&["e", "extax", "ext", "externalaxis", "axisacte"], 1..=6)
        || unit.or(below).is_some_and(is_length)
            && begins_with(&["j", "a", "q", "axis", "joint"], n_joints + 1..=99)
}

/// The refusal of a table with an external axis that moves. `is_free` says whether a column is neither read nor left aside.
pub fn moving_axis(
    table: &Table,
    is_free: impl Fn(usize) -> bool,
    n_joints: usize,
) -> Option<Issue> {
    let below = |place: usize| {
        table
            .units
            .as_ref()
            .and_then(|units| units.get(place).copied().flatten())
    };
    let mut places = (0..table.header.len()).filter(|place| is_free(*place));
    places.find_map(|place| {
        let name = &table.header[place];
        let is_axis = is_external(name, below(place), n_joints);
        let [least, largest] = is_axis.then(|| extremes(table, place))??;
        (largest.0 - least.0 > STANDSTILL).then(|| in_words(&table.name(place), least, largest))
    })
}

/// The least and the largest value of a column, each with its line.
fn extremes(table: &Table, place: usize) -> Option<[(f64, usize); 2]> {
    let mut found: Option<[(f64, usize); 2]> = None;
    table.each_row(|next| {
        let Next::Row(row) = next else { return true };
        let cell = row.cells.get(place).unwrap_or("").trim();
        let number = value(cell, Decimal::Point).or_else(|| value(cell, Decimal::Comma));
        if let Some(number) = number {
            let at = (number, row.line);
            let [least, largest] = found.get_or_insert([at, at]);
            if at.0 < least.0 {
                *least = at;
            }
            if at.0 > largest.0 {
                *largest = at;
            }
        }
        true
    });
    found
}

fn in_words(name: &str, least: (f64, usize), largest: (f64, usize)) -> Issue {
    let detail = format!(
        "the external axis {name} moves between the rows: {} in line {} and {} in line {}. It is not read, and a track moves the robot's base: measure with it at \
         one place. If it stood at a few places, write the rows of each into a file of its own; if it moves neither robot nor reflector, leave it aside in the \
         column mapping: {{\"ignore\": [{name:?}]}}",
        least.0, least.1, largest.0, largest.1
    );
    Issue::new("external_axis_moves", detail).in_column(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::is_external;

    #[test]
    fn external_axes_are_known_by_their_names() {
        for name in [
            "E1 [mm]",
            "e6",
            "EXTAX",
            "Ext. axis",
            "eax_a",
            "J7 [mm]",
            "$AXIS_ACT.E1",
        ] {
            let is_it = is_external(name, None, 6);
            assert_eq!(is_it, name != "Ext. axis", "{name}");
        }
        for name in [
            "E7", "error", "J6 [deg]", "A", "Ext", "eax", "J7 [deg]", "q1_mm",
        ] {
            assert!(!is_external(name, None, 6), "{name}");
        }
    }
}
