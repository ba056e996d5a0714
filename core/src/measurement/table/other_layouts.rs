//! Detects tables that have no row per point: transposed tables, rows for single coordinates, and names beside each number. They are
//! refused with advice how to write them.

use crate::measurement::columns::names::{Known, recognise};
use crate::measurement::issue::Issue;
use crate::measurement::table::Table;
use crate::measurement::table::lines::is_numeric;
use crate::measurement::table::resolution::Resolution;
use std::collections::BTreeSet;

/// Number of rows that are examined.
const SAMPLE: usize = 60;
/// Minimum number of names of joints and coordinates in the first column of a transposed table.
const MIN_NAMES: usize = 4;
/// Minimum number of cells of a row with a name and a number.
const MIN_LABELLED: usize = 3;

/// The issue for a table with missing columns that has another layout.
pub fn other_layout(resolution: &Resolution) -> Option<Issue> {
    let missing = resolution.columns.missing.first()?;
    let table = resolution.table;
    let rows = table.first_rows(SAMPLE, SAMPLE);
    let detail = transposed(table, &rows)
        .or_else(|| row_per_coordinate(resolution, &rows))
        .or_else(|| labelled(table, &rows))?;
    Some(Issue::new("missing_column", detail).in_column(missing.clone()))
}

fn transposed(table: &Table, rows: &[Vec<String>]) -> Option<String> {
    let first = table.header.first().into_iter();
    let first = first.chain(rows.iter().filter_map(|row| row.first()));
    let names: BTreeSet<&String> = first
        .filter(|name| {
            matches!(
                recognise(name, None),
                Known::Joint(..) | Known::Position(..)
            )
        })
        .collect();
    let is_wide = rows.iter().any(|row| row.len() > 2);
    (names.len() >= MIN_NAMES && is_wide).then(|| {
        let names: Vec<String> = names.iter().map(|name| format!("{name:?}")).collect();
        format!(
            "the table is transposed: its first column has the names {}. Write one row per point (in a spreadsheet program: copy, paste special, transpose)",
            names.join(", ")
        )
    })
}

fn row_per_coordinate(resolution: &Resolution, rows: &[Vec<String>]) -> Option<String> {
    let table = resolution.table;
    let is_missing = |means: &String| means.starts_with(['x', 'y', 'z']);
    if !resolution.columns.missing.iter().any(is_missing) {
        return None;
    }
    let are_axes = |place: &usize| {
        let cells = rows
            .iter()
            .map(|row| row.get(*place).map_or("", String::as_str));
        let cells: BTreeSet<String> = cells.map(str::to_lowercase).collect();
        cells.iter().map(String::as_str).eq(["x", "y", "z"])
    };
    let place = (0..table.header.len()).find(are_axes)?;
    Some(format!(
        "each point has three rows, one for each coordinate (column {} has X, Y and Z): write one row per point, with the columns name, x_mm, y_mm and z_mm",
        table.name(place)
    ))
}

/// Rows such as `P1 A1=10.5 A2=20.0` or `P1 X: 10.5 Y: 20.0`.
fn labelled(table: &Table, rows: &[Vec<String>]) -> Option<String> {
    let is_label = |text: &str| {
        let text = text.trim();
        text.len() <= 12
            && text.starts_with(char::is_alphabetic)
            && text.chars().all(|c| c.is_alphanumeric() || c == '_')
    };
    let is_labelled = |cell: &&String| {
        let parts = cell.split_once(['=', ':']);
        parts.is_some_and(|(name, number)| {
            is_label(name) && (number.trim().is_empty() || is_numeric(number))
        })
    };
    let n_labelled = |row: &Vec<String>| row.iter().filter(is_labelled).count();
    let with = rows.iter().filter(|row| n_labelled(row) >= MIN_LABELLED);
    let sample = rows.iter().flatten().find(is_labelled)?;
    (2 * with.count() > rows.len()).then(|| {
        let what = match table.header_line {
            Some(_) => "most rows have names beside their numbers",
            None => "the rows have names beside their numbers",
        };
        format!(
            "{what} ({sample:?}): write the names once, in a first line (name,q1_deg,…,q6_deg, or name,x_mm,y_mm,z_mm), and below it the numbers alone, one row per point: in an \
             editor, replace each name by a comma"
        )
    })
}
