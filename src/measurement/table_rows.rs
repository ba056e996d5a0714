//! The rows of a table: reads them one by one to points and join keys, and refuses those that hold no measurement.

use crate::measurement::csv::{MAX_ROWS, PULSES, Reading, parse_row};
use crate::measurement::csv_columns::Column;
use crate::measurement::csv_issue::{Issue, MAX_ISSUES};
use crate::measurement::number_text::without_unit;
use crate::measurement::set::Point;
use crate::measurement::table::{Next, Table};
use crate::measurement::table_flags::Flags;
use crate::measurement::table_groups::rows_of_groups;
use crate::measurement::table_lines::is_numeric;
use crate::measurement::table_reflectors::reflectors;
use crate::measurement::table_repeats::rows_again;
use crate::measurement::table_resolution::Used;
use crate::measurement::table_row_ends::{Ends, RowEnds};
use crate::measurement::table_statistics::{is_statistic, rows_not_measured, rows_of_statistics};

/// Joint values beyond this, rad, are usual of one joint at most: two turns.
const SEVERAL_TURNS_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Cells of a column with and without a unit behind the number: how many, and row and line of the first one.
#[derive(Clone, Copy, Debug, Default)]
struct UnitsOfCells {
    n_with: usize,
    first_with: Option<(usize, usize)>,
    n_without: usize,
    first_without: Option<(usize, usize)>,
}

/// The rows that were read so far.
#[derive(Default)]
pub(super) struct Rows {
    pub(super) points: Vec<Point>,
    pub(super) lines: Vec<usize>,
    pub(super) keys: Vec<(String, Vec<String>)>,
    pub(super) issues: Vec<(Issue, Option<usize>)>,
    pub(super) n_skipped: usize,
    n_rows: usize,
    /// Number of other rows that begin with a number.
    n_numbered: usize,
    /// For each column, the cells with and without its unit behind the number.
    with_unit: Vec<UnitsOfCells>,
    /// Rows that have the name of a statistic in front of their numbers.
    summaries: Vec<Summary>,
    /// Rows that end before or behind the last column.
    ends: RowEnds,
    /// Columns that may say which rows count.
    flags: Flags,
    /// For each point, the cell with its reflector.
    reflector_cells: Vec<String>,
    /// The names of the reflectors in the order of their numbers, if the file has names.
    pub(super) reflectors: Vec<String>,
}

/// A row that has the name of a statistic in front of its numbers.
struct Summary {
    row: usize,
    line: usize,
    word: String,
    /// Whether this cell is read as a label.
    is_label: bool,
}

fn is_of_target(column: &Column) -> bool {
    matches!(column, Column::Target | Column::TargetName)
}

/// The columns that are read, and their use.
pub(super) struct Layout {
    /// Indices of the columns whose cells become points. `columns` and `names` are their types and names.
    pub(super) places: Vec<usize>,
    pub(super) columns: Vec<Column>,
    pub(super) names: csv::StringRecord,
    /// The unit of each column, for joints and positions.
    pub(super) units: Vec<Option<&'static str>>,
    /// The columns of join keys.
    pub(super) keys: Vec<Used>,
    /// Where the cells that are read stand.
    pub(super) ends: Ends,
    /// The columns that the caller leaves aside.
    pub(super) ignored: Vec<usize>,
    /// Whether the file is a stored upload that is read again in the same way.
    pub(super) is_read_again: bool,
    /// Whether the rows have positions.
    pub(super) has_positions: bool,
    /// Whether the rows are targets of a program.
    pub(super) are_targets: bool,
}

impl Layout {
    /// The unit of each coordinate in the file, mm.
    fn millimetres(&self) -> [f64; 3] {
        let factor = |axis: usize| {
            let of_axis = |column: &Column| match column {
                Column::Position(of, factor) if *of == axis => Some(*factor),
                _ => None,
            };
            self.columns.iter().find_map(of_axis).unwrap_or(1.0)
        };
        std::array::from_fn(factor)
    }

    /// The cells in front of the first number that is read, and whether each is read as a label. One of them may be the name of a statistic.
    fn leading_cells<'r>(
        &self,
        row: &'r csv::StringRecord,
    ) -> impl Iterator<Item = (&'r str, bool)> {
        let is_left_aside = |place: &usize| self.ignored.contains(place);
        let filled = row
            .iter()
            .enumerate()
            .filter(move |(place, cell)| !cell.trim().is_empty() && !is_left_aside(place));
        filled.map_while(|(place, cell)| {
            let read = self.places.iter().position(|read| *read == place);
            let is_label = match read.map(|at| self.columns[at]) {
                None => false,
                Some(Column::Configuration | Column::Station | Column::Session) => true,
                Some(_) => return None,
            };
            Some((cell.trim(), is_label))
        })
    }
}

impl Rows {
    pub(super) fn new(table: &Table, layout: &Layout) -> Self {
        let keys = layout.keys.iter();
        let is_free = |place: &usize| {
            let is_key = layout.keys.iter().any(|used| used.place == *place);
            !is_key && !layout.places.contains(place) && !layout.ignored.contains(place)
        };
        Self {
            flags: Flags::new(table, !layout.has_positions, is_free),
            keys: keys.map(|used| (used.means.clone(), vec![])).collect(),
            with_unit: vec![UnitsOfCells::default(); layout.places.len()],
            ..Self::default()
        }
    }

    /// Checks the reflectors of the points, and numbers them unless they have a `target_name`: the set numbers these.
    pub(super) fn number_reflectors(&mut self, layout: &Layout) {
        let column = layout.columns.iter().position(is_of_target);
        let Some(column) = column.filter(|_| self.issues.is_empty()) else {
            return;
        };
        let cells = std::mem::take(&mut self.reflector_cells);
        let are_names = layout.columns[column] == Column::TargetName;
        let found = reflectors(
            &cells,
            &layout.names[column],
            are_names,
            layout.is_read_again,
        );
        match found {
            Ok(_) if are_names => {}
            Ok(found) => {
                for (point, number) in self.points.iter_mut().zip(found.numbers) {
                    point.target = number;
                }
                self.reflectors = found.names;
            }
            Err(issue) => {
                let line = issue.row.and_then(|row| self.lines.get(row).copied());
                self.issues.push((issue, line));
            }
        }
    }

    /// Refuses rows that hold no measurement. Of a file that was accepted once, all rows are measurements.
    pub(super) fn refuse_no_measurements(&mut self, table: &Table, layout: &Layout) {
        if layout.is_read_again {
            return;
        }
        self.refuse_summaries();
        let moved = self.ends.refused(table, &layout.ends);
        self.issues.extend(moved);
        self.refuse_some_units(layout);
        if self.issues.is_empty() && !layout.are_targets {
            self.issues.extend(self.flags.refused(table));
        }
        if layout.has_positions && self.issues.is_empty() {
            self.refuse_not_measured(layout);
        }
        let has_joints = (layout.columns.iter()).any(|column| matches!(column, Column::Joint(..)));
        if layout.has_positions && has_joints && self.issues.is_empty() {
            self.refuse_rows_again();
            self.refuse_pulses();
        }
        if layout.has_positions && self.issues.is_empty() {
            self.refuse_statistics();
        }
        if layout.has_positions && self.issues.is_empty() {
            self.refuse_statistics_of_groups(layout);
        }
    }

    /// Refuses rows that have the name of a statistic in front of their numbers, if they are less than a quarter of all rows, or if all others begin with a number. In other
    /// files the word is part of a normal column.
    fn refuse_summaries(&mut self) {
        let is_numbered =
            self.n_numbered > 0 && self.n_numbered + self.summaries.len() == self.n_rows;
        let is_rare = 4 * self.summaries.len() < self.n_rows;
        for found in std::mem::take(&mut self.summaries) {
            let Summary {
                row,
                line,
                word,
                is_label,
            } = found;
            if is_numbered || is_rare && !is_label {
                let detail = format!(
                    "row {row} has the name {word:?}: a row of statistics is no measurement; remove it, or put # before it; if it is a point's name, name it otherwise"
                );
                self.issue(Some(row), Some(line), "summary_row", detail);
            }
        }
    }

    /// Refuses columns in which some numbers have a unit behind them and others have none.
    fn refuse_some_units(&mut self, layout: &Layout) {
        for (column, units) in std::mem::take(&mut self.with_unit).into_iter().enumerate() {
            let (Some(with), Some(without)) = (units.first_with, units.first_without) else {
                continue;
            };
            let ((row, line), code, what) = match units.n_with < units.n_without {
                true => (
                    with,
                    "not_a_number",
                    "the cell is not a number: it has a unit, and others of the column have none",
                ),
                false => (
                    without,
                    "cell_unit",
                    "the number has no unit, and others of the column have one",
                ),
            };
            let name = &layout.names[column];
            let detail = format!(
                "row {row}, column {name}: {what}: write it behind every number, or only into the column's name"
            );
            let issue = Issue {
                row: Some(row),
                column: Some((*name).to_owned()),
                code,
                detail,
            };
            self.issues.push((issue, Some(line)));
        }
    }

    /// A cell without the unit of its column behind the number.
    ///
    /// # Errors
    /// If it has another unit.
    fn bare<'r>(
        &mut self,
        (row, line): (usize, usize),
        cell: &'r str,
        column: usize,
        layout: &Layout,
    ) -> Result<&'r str, Issue> {
        let Some(own) = layout.units[column] else {
            return Ok(cell);
        };
        let (number, unit) = without_unit(cell);
        let units = &mut self.with_unit[column];
        match unit {
            None => {
                units.n_without += 1;
                units.first_without.get_or_insert((row, line));
            }
            Some(unit) if unit == own => {
                units.n_with += 1;
                units.first_with.get_or_insert((row, line));
            }
            Some(unit) => {
                let name = &layout.names[column];
                let detail = format!(
                    "row {row}, column {name}: {cell:?} is not a number of this column: it is in {unit}, and the column in {own}: write the numbers in one unit, and the unit into the column's name"
                );
                return Err(Issue {
                    row: Some(row),
                    column: Some((*name).to_owned()),
                    code: "not_a_number",
                    detail,
                });
            }
        }
        Ok(number)
    }

    fn refuse_not_measured(&mut self, layout: &Layout) {
        let found = rows_not_measured(&self.points, layout.millimetres());
        let n = found.len();
        for (at, position) in found.into_iter().take(MAX_ISSUES) {
            // No row was refused, so points and rows are counted alike.
            let rows = if n == 1 {
                ""
            } else {
                &format!(", as in {n} rows")
            };
            let detail = format!(
                "row {at}: the position is {position}{rows}: so instruments write what they have not measured; remove such rows, or put # before them"
            );
            self.issue(Some(at), Some(self.lines[at]), "not_measured", detail);
        }
    }

    /// Refuses rows that stand in the file twice.
    fn refuse_rows_again(&mut self) {
        let found = rows_again(&self.points);
        let n = found.len();
        for (at, first) in found.into_iter().take(MAX_ISSUES) {
            let detail = format!(
                "row {at} agrees with row {first} in every digit of joints and position, as {n} rows in all do with earlier ones: repeated measurements differ by their noise, so a table \
                 stands here twice; remove these rows"
            );
            self.issue(Some(at), Some(self.lines[at]), "rows_twice", detail);
        }
    }

    /// Refuses joint values that no robot has: no robot turns three joints several times.
    fn refuse_pulses(&mut self) {
        let rows = |joint: usize| {
            let turned = |point: &Point| point.q_rad[joint].abs() > SEVERAL_TURNS_RAD;
            self.points.iter().position(turned)
        };
        let n_joints = self.points.first().map_or(0, |point| point.q_rad.len());
        let turned: Vec<(usize, usize)> = (0..n_joints)
            .filter_map(|joint| Some((joint, rows(joint)?)))
            .collect();
        let Some((joint, row)) = turned.first().filter(|_| turned.len() >= n_joints.min(3)) else {
            return;
        };
        let detail = format!(
            "row {row}: joint {} is at {:.0}°, and {} joints turn more than twice: {PULSES}",
            joint + 1,
            self.points[*row].q_rad[*joint].to_degrees(),
            turned.len()
        );
        self.issue(Some(*row), Some(self.lines[*row]), "out_of_range", detail);
    }

    /// Refuses rows above or below the measurements that are their mean, standard deviation and the like, whatever they are called.
    fn refuse_statistics(&mut self) {
        for (at, name) in rows_of_statistics(&self.points) {
            let detail = format!(
                "row {at} is the {name} of the other rows in every column: a row of statistics is no measurement; remove it, or put # before it"
            );
            self.issue(Some(at), Some(self.lines[at]), "summary_row", detail);
        }
    }

    /// Refuses rows that are the mean and the like of the measurements of their pose.
    fn refuse_statistics_of_groups(&mut self, layout: &Layout) {
        let found = rows_of_groups(&self.points, &self.reflector_cells, layout.millimetres());
        let n = found.len();
        for statistic in found.into_iter().take(MAX_ISSUES) {
            let (at, first) = (statistic.row, statistic.first);
            let detail = format!(
                "row {at} is the {} of {} others in every column (the first of them is row {first}), and {n} rows in all are such statistics of their groups: a row of statistics is no measurement; \
                 remove such rows",
                statistic.name, statistic.n_measured
            );
            self.issue(Some(at), Some(self.lines[at]), "summary_row", detail);
        }
    }

    pub(super) fn issue(
        &mut self,
        row: Option<usize>,
        line: Option<usize>,
        code: &'static str,
        detail: String,
    ) {
        let issue = Issue {
            row,
            column: None,
            code,
            detail,
        };
        self.issues.push((issue, line));
    }

    /// Reads the next row. Returns false if no further rows are wanted.
    pub(super) fn take(
        &mut self,
        next: Next,
        table: &Table,
        layout: &Layout,
        reading: &Reading,
    ) -> bool {
        let row = match next {
            Next::Row(row) => row,
            Next::Skipped => {
                self.n_skipped += 1;
                return true;
            }
            Next::Bad(line, code, detail) => {
                let row = self.n_rows;
                self.issue(
                    Some(row),
                    Some(line),
                    code,
                    format!("row {row} cannot be read: {detail}"),
                );
                self.n_rows += 1;
                return self.issues.len() < MAX_ISSUES;
            }
        };
        let index = self.n_rows;
        if index >= MAX_ROWS {
            self.issues.clear();
            let detail = format!("more than {MAX_ROWS} rows; split the campaign into several sets");
            self.issue(None, None, "too_many_rows", detail);
            return false;
        }
        self.n_rows += 1;
        if let Err(detail) = self.ends.take(index, &row, table, &layout.ends) {
            self.issue(Some(index), Some(row.line), "wrong_cell_count", detail);
            return self.issues.len() < MAX_ISSUES;
        }
        self.flags.take(index, &row);
        let mut reflector = None;
        let mut cells = csv::StringRecord::new();
        for (column, place) in layout.places.iter().enumerate() {
            let cell = row.cells.get(*place).unwrap_or("");
            match self.bare((index, row.line), cell, column, layout) {
                Ok(cell) if is_of_target(&layout.columns[column]) && !cell.trim().is_empty() => {
                    // numbered when all rows are known
                    reflector = Some(cell.trim().to_owned());
                    let is_name = layout.columns[column] == Column::TargetName;
                    cells.push_field(if is_name { cell } else { "0" });
                }
                Ok(cell) => cells.push_field(cell),
                Err(issue) => {
                    self.issues.push((issue, Some(row.line)));
                    return self.issues.len() < MAX_ISSUES;
                }
            }
        }
        let mut issues = Vec::new();
        let point = parse_row(
            index,
            &cells,
            &layout.names,
            &layout.columns,
            reading,
            &mut issues,
        );
        self.issues
            .extend(issues.into_iter().map(|issue| (issue, Some(row.line))));
        let leading: Vec<(&str, bool)> = layout.leading_cells(&row.cells).collect();
        let statistic = leading.iter().find(|(cell, _)| is_statistic(cell));
        if let Some((word, is_label)) = statistic {
            self.summaries.push(Summary {
                row: index,
                line: row.line,
                word: (*word).to_owned(),
                is_label: *is_label,
            });
        } else if leading.first().is_some_and(|(cell, _)| is_numeric(cell)) {
            self.n_numbered += 1;
        }
        if let Some(point) = point {
            self.points.push(point);
            self.lines.push(row.line);
            self.reflector_cells.extend(reflector);
            for (used, (_, cells)) in layout.keys.iter().zip(&mut self.keys) {
                cells.push(row.cells.get(used.place).unwrap_or("").trim().to_owned());
            }
        }
        self.issues.len() < MAX_ISSUES
    }
}
