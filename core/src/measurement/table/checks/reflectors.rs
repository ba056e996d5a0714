//! Reads the cells that identify the reflector of a row: its number from 0, or its name.

use crate::measurement::csv::MAX_TARGETS;
use crate::measurement::issue::Issue;
use crate::measurement::set::numbered;
use std::collections::BTreeSet;

/// If a column has a different value in each of at least this many rows, it names points and not reflectors.
const MIN_POINTS_NAMED: usize = 4;
/// If a column has at least this many different values, each in two rows or fewer on average, it names points that were measured twice.
const MIN_NAMED_TWICE: usize = 8;

/// The reflectors of a table.
#[derive(Debug, PartialEq)]
pub struct Reflectors {
    /// For each row, the number of its reflector, counted from 0.
    pub numbers: Vec<usize>,
    /// The names of the reflectors in the order of their numbers; empty if the cells are numbers.
    pub names: Vec<String>,
}

/// Numbers the reflectors of the rows: by the numbers in the file, or by names in the order in which they first appear. If `are_names` is
/// true, numbers are names too. `column` is the column's name.
///
/// # Errors
/// `not_an_index` for numbers that are no number of a reflector, `two_readings` for a column of a new file that names points.
pub fn reflectors(
    cells: &[String],
    column: &str,
    are_names: bool,
    is_read_again: bool,
) -> Result<Reflectors, Issue> {
    let issue = |row: Option<usize>, code: &'static str, detail: String| {
        Issue::new(code, detail)
            .in_row(row)
            .in_column(column.to_owned())
    };
    let different: BTreeSet<&str> = cells.iter().map(String::as_str).collect();
    let are_all_different = different.len() == cells.len() && cells.len() >= MIN_POINTS_NAMED;
    let are_twice = different.len() >= MIN_NAMED_TWICE && 2 * different.len() >= cells.len();
    if !is_read_again && (are_all_different || are_twice) {
        let detail = format!(
            "column {column} has {} different values in {} rows: so it names points, not reflectors (target): leave it aside in the column \
             mapping: {{\"ignore\": [{column:?}]}}, or say that it has the points' names, in the column mapping: {{\"name\": {column:?}}}",
            different.len(),
            cells.len()
        );
        return Err(issue(None, "two_readings", detail));
    }
    let number = |cell: &String| cell.parse().ok().filter(|number| *number < MAX_TARGETS);
    if !are_names && let Some(numbers) = cells.iter().map(number).collect() {
        let names = vec![];
        return Ok(Reflectors { numbers, names });
    }
    // If most cells are numbers, the others are mistakes and not names.
    let n_numbers = cells
        .iter()
        .filter(|cell| cell.parse::<f64>().is_ok())
        .count();
    if !are_names && 2 * n_numbers > cells.len() {
        let row = cells.iter().position(|cell| number(cell).is_none());
        let detail = format!(
            "row {}, column {column}: {:?} is not a whole number from 0 to {}",
            row.unwrap_or(0),
            cells[row.unwrap_or(0)],
            MAX_TARGETS - 1
        );
        return Err(issue(row, "not_an_index", detail));
    }
    let (numbers, names) = numbered(cells.iter().map(String::as_str));
    if let Some(row) = numbers.iter().position(|number| *number >= MAX_TARGETS) {
        let detail = format!(
            "column {column} has more than {MAX_TARGETS} different names, and a tool has at most {MAX_TARGETS} reflectors (target): if it names \
             points, leave it aside in the column mapping: {{\"ignore\": [{column:?}]}}"
        );
        return Err(issue(Some(row), "not_an_index", detail));
    }
    let names = names.into_iter().map(str::to_owned).collect();
    Ok(Reflectors { numbers, names })
}

#[cfg(test)]
mod tests {
    use super::{Reflectors, reflectors};

    fn numbered(cells: &[&str]) -> Result<Reflectors, &'static str> {
        let cells: Vec<String> = cells.iter().map(|cell| (*cell).to_owned()).collect();
        reflectors(&cells, "SMR", false, false).map_err(|issue| issue.code)
    }

    #[test]
    fn reflectors_have_numbers_or_names() {
        let found = numbered(&["2", "0", "2", "1"]).unwrap();
        assert_eq!((found.numbers, found.names.len()), (vec![2, 0, 2, 1], 0));
        let found = numbered(&["B", "A", "B", "C"]).unwrap();
        assert_eq!(found.numbers, [0, 1, 0, 2]);
        assert_eq!(found.names, ["B", "A", "C"]);
        assert_eq!(numbered(&["1", "1", "40"]), Err("not_an_index"));
        assert_eq!(numbered(&["1", "1", "-1"]), Err("not_an_index"));
        assert_eq!(numbered(&["P1", "P2", "P3", "P4"]), Err("two_readings"));
        assert_eq!(numbered(&["1", "2", "3", "4"]), Err("two_readings"));
        assert_eq!(numbered(&["0", "1", "0", "O"]), Err("not_an_index"));
        let twice: Vec<String> = (0..20).map(|row| format!("P{}", row / 2)).collect();
        let twice: Vec<&str> = twice.iter().map(String::as_str).collect();
        assert_eq!(numbered(&twice), Err("two_readings"));
        // One measurement with each of three reflectors.
        assert!(numbered(&["0", "1", "2"]).is_ok());
    }
}
