//! Finds the decimal mark of a table: point or comma. A table for which both are possible is refused.

use crate::measurement::columns::column::Column;
use crate::measurement::conventions::Decimal;
use crate::measurement::csv::number_text::{decimal_of_both, plain, without_unit};
use crate::measurement::csv::{MAX_COORDINATE_MM, MAX_JOINT_RAD, MAX_ROWS};
use crate::measurement::issue::{ParseError, whole};
use crate::measurement::table::{Next, Table};

/// Number of unambiguous cells for each decimal mark.
#[derive(Clone, Copy, Debug, Default)]
struct Marks {
    points: usize,
    commas: usize,
    /// The first ambiguous cell: its line and the mark in it.
    unclear: Option<(usize, char)>,
}

/// The decimal mark of the columns that hold numbers.
///
/// # Errors
/// `two_readings` if all numbers with a mark are ambiguous.
pub(super) fn decimal_mark(
    table: &Table,
    numbers: &[(usize, Option<Column>)],
) -> Result<Decimal, ParseError> {
    let mut marks = Marks::default();
    let mut example = String::new();
    let mut n_rows = 0;
    table.each_row(|next| {
        if let Next::Row(row) = next {
            n_rows += 1;
            for (place, column) in numbers {
                let cell = row.cells.get(*place).unwrap_or("").trim();
                let (cell, _) = without_unit(cell);
                if count(&mut marks, cell, *column, row.line) {
                    example = cell.into();
                }
            }
        }
        // After many unambiguous cells, the rest of the file need not be read.
        n_rows <= MAX_ROWS && marks.points + marks.commas < 1000
    });
    match (marks.points, marks.commas, marks.unclear) {
        (0, 0, Some((line, mark))) => {
            let (decimal, thousands) = both_readings(&example, mark);
            let detail = format!(
                "line {line}: {example:?} is {decimal} if {mark:?} is the decimal mark, and {thousands} if it separates thousands, and no number of \
                 the file tells which. State it in the column mapping: {{\"decimal\": {0:?}}}, or write the numbers without separators of thousands",
                if mark == ',' { "comma" } else { "point" }
            );
            Err(whole("two_readings", detail))
        }
        (points, commas, _) if commas > points => Ok(Decimal::Comma),
        _ => Ok(Decimal::Point),
    }
}

/// The decimal mark of these columns, which may hold any numbers. None if all numbers with a mark are ambiguous.
pub fn decimal_of(table: &Table, places: &[usize]) -> Option<Decimal> {
    let numbers: Vec<(usize, Option<Column>)> = places.iter().map(|at| (*at, None)).collect();
    decimal_mark(table, &numbers).ok()
}

fn both_readings(cell: &str, mark: char) -> (String, String) {
    (cell.replace(mark, "."), cell.replace(mark, ""))
}

/// Counts a cell. Returns true if it is the first ambiguous cell.
fn count(marks: &mut Marks, cell: &str, column: Option<Column>, line: usize) -> bool {
    let mark = match (cell.contains('.'), cell.contains(',')) {
        (true, false) => '.',
        (false, true) => ',',
        (true, true) => {
            // A number with both marks, such as 1.234,5, is unambiguous.
            match decimal_of_both(cell) {
                Some('.') => marks.points += 1,
                Some(_) => marks.commas += 1,
                None => {}
            }
            return false;
        }
        (false, false) => return false,
    };
    let cell = &*plain(cell, mark);
    let (decimal, thousands) = both_readings(cell, mark);
    let Ok(_) = decimal.parse::<f64>() else {
        return false;
    };
    let is_grouped = is_group_of_three(cell, mark);
    if is_grouped
        && thousands
            .parse()
            .is_ok_and(|value| is_possible(value, column))
    {
        let is_first = marks.unclear.is_none();
        marks.unclear.get_or_insert((line, mark));
        return is_first;
    }
    match mark {
        '.' => marks.points += 1,
        _ => marks.commas += 1,
    }
    false
}

/// Whether the mark may be a thousands separator: true for `1,234`, false for `0,234`, `1234,567` and `1,2345`.
fn is_group_of_three(cell: &str, mark: char) -> bool {
    let plain = cell.trim_start_matches(['+', '-']);
    plain.split_once(mark).is_some_and(|(before, after)| {
        let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
        after.len() == 3
            && digits(after)
            && digits(before)
            && (1..=3).contains(&before.len())
            && !before.starts_with('0')
    })
}

/// Whether a value is within the allowed range of its column.
fn is_possible(value: f64, column: Option<Column>) -> bool {
    match column {
        Some(Column::Joint(_, factor)) => (value * factor).abs() <= MAX_JOINT_RAD,
        Some(Column::Position(_, factor)) => (value * factor).abs() <= MAX_COORDINATE_MM,
        _ => true,
    }
}
