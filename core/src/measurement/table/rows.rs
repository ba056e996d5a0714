//! Reads the rows of a table one by one to points and join keys, and refuses those that are no measurements.

use crate::measurement::columns::column::Column;
use crate::measurement::csv::number_text::without_unit;
use crate::measurement::csv::{MAX_ROWS, Reading, parse_row};
use crate::measurement::issue::{Issue, MAX_ISSUES, ParseError};
use crate::measurement::set::Point;
use crate::measurement::table::checks::configurations::unlike_poses;
use crate::measurement::table::checks::flags::Flags;
use crate::measurement::table::checks::names::Names;
use crate::measurement::table::checks::no_measurements;
use crate::measurement::table::checks::point_groups::{
    PointGroups, point_in_group, several_groups,
};
use crate::measurement::table::checks::reflectors::reflectors;
use crate::measurement::table::checks::row_ends::{Ends, RowEnds};
use crate::measurement::table::checks::statistics::is_statistic;
use crate::measurement::table::lines::is_numeric;
use crate::measurement::table::resolution::Used;
use crate::measurement::table::{Next, Table};

/// For a column: the number of cells with a unit after the number, that of cells without one, and the first row of each.
#[derive(Clone, Copy, Debug, Default)]
struct UnitsOfCells {
    n_with: usize,
    first_with: Option<usize>,
    n_without: usize,
    first_without: Option<usize>,
}

/// The rows that were read so far.
#[derive(Default)]
pub struct Rows {
    pub points: Vec<Point>,
    /// The line of each row.
    pub lines: Vec<usize>,
    pub keys: Vec<(String, Vec<String>)>,
    pub issues: Vec<Issue>,
    pub n_skipped: usize,
    n_rows: usize,
    /// Number of other rows that begin with a number.
    n_numbered: usize,
    /// For each column, the cells with and without a unit after the number.
    with_unit: Vec<UnitsOfCells>,
    /// Rows with the name of a statistic before their numbers.
    summaries: Vec<Summary>,
    /// The number of cells in each row, compared with the columns that are read.
    ends: RowEnds,
    /// Columns that may show which rows are valid.
    flags: Flags,
    /// Names of points that mark invalid rows, or that show two tables side by side.
    names: Names,
    /// The groups of the points, and which of them are read.
    pub groups: PointGroups,
    /// For each point, the cell with its reflector.
    reflector_cells: Vec<String>,
    /// The names of the reflectors in the order of their numbers, if the file has names.
    pub reflectors: Vec<String>,
}

/// A row with the name of a statistic before its numbers.
struct Summary {
    row: usize,
    word: String,
    /// Whether this cell is read as a label.
    is_label: bool,
}

fn is_of_target(column: &Column) -> bool {
    matches!(column, Column::Target | Column::TargetName)
}

/// The columns that are read, and their use.
pub struct Layout {
    /// Indices of the columns whose cells become points. `columns` and `names` are their types and names.
    pub places: Vec<usize>,
    pub columns: Vec<Column>,
    pub names: csv::StringRecord,
    /// The unit of each column, for joints and positions.
    pub units: Vec<Option<&'static str>>,
    /// The columns of join keys.
    pub keys: Vec<Used>,
    /// The range of columns that are read.
    pub ends: Ends,
    /// The columns that the mapping ignores.
    pub ignored: Vec<usize>,
    /// Whether the file is a stored upload that is read again in the same way.
    pub is_read_again: bool,
    /// Whether the rows have positions.
    pub has_positions: bool,
    /// Whether the rows are targets of a program.
    pub are_targets: bool,
    /// The groups of points to read; empty for all.
    pub groups: Vec<String>,
}

impl Layout {
    /// The groups of points of the rows. Only rows with positions have groups.
    fn point_groups(&self) -> PointGroups {
        let place = |means: &str| {
            let column = self.keys.iter().find(|used| used.means == means);
            column.map(|used| used.place)
        };
        let columns = [place("collection"), place("group")];
        match self.has_positions {
            true => PointGroups::new(
                place("name"),
                columns.into_iter().flatten().collect(),
                self.groups.clone(),
            ),
            false => PointGroups::default(),
        }
    }

    fn has_joints(&self) -> bool {
        let is_joint = |column: &Column| matches!(column, Column::Joint(..));
        self.columns.iter().any(is_joint)
    }

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

    /// The cells before the first number that is read, each with whether it is read as a label. One of them may be the name of a statistic.
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
    pub fn new(table: &Table, layout: &Layout) -> Self {
        let keys = layout.keys.iter();
        let is_free = |place: &usize| {
            let is_key = layout.keys.iter().any(|used| used.place == *place);
            !is_key && !layout.places.contains(place) && !layout.ignored.contains(place)
        };
        let read = |is_wanted: fn(&Column) -> bool| -> Vec<usize> {
            let columns = layout.places.iter().zip(&layout.columns);
            let wanted = columns.filter(|(_, column)| is_wanted(column));
            wanted.map(|(place, _)| *place).collect()
        };
        let own = layout.keys.iter().find(|used| used.means == "name");
        Self {
            names: Names::new(
                table,
                own.map(|used| used.place),
                &read(|column| matches!(column, Column::Joint(..))),
                &read(|column| matches!(column, Column::Position(..))),
                |place| !layout.ignored.contains(&place),
            ),
            groups: layout.point_groups(),
            flags: Flags::new(table, !layout.has_positions, is_free),
            keys: keys.map(|used| (used.means.clone(), vec![])).collect(),
            with_unit: vec![UnitsOfCells::default(); layout.places.len()],
            ..Self::default()
        }
    }

    /// Checks the reflectors of the points. Numbers them, unless they have a `target_name`; those are numbered by the set.
    pub fn number_reflectors(&mut self, layout: &Layout) {
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
            Err(issue) => self.issues.push(issue),
        }
    }

    /// Refuses rows that are no measurements. In a stored file, which was accepted once, all rows are measurements.
    pub fn refuse_no_measurements(&mut self, table: &Table, layout: &Layout) {
        if layout.is_read_again {
            return;
        }
        let unknown = self.groups.unknown();
        let unknown = unknown.map(|detail| Issue::new("no_rows", detail));
        self.issues.extend(unknown);
        self.refuse_summaries();
        let moved = self.ends.refused(table, &layout.ends);
        self.issues.extend(moved);
        self.refuse_some_units(layout);
        if layout.has_positions && layout.has_joints() && self.issues.is_empty() {
            self.refuse_several_groups(layout);
        }
        if self.issues.is_empty() && !layout.are_targets {
            self.issues.extend(self.flags.refused(table));
            self.issues.extend(self.names.refused(table));
        }
        if layout.has_positions && self.issues.is_empty() {
            let found = no_measurements(
                &self.points,
                &self.reflector_cells,
                layout.millimetres(),
                layout.has_joints(),
            );
            // No row was refused before, so points and rows have the same indices.
            self.issues = found;
        }
        let is_label = |column: &Column| *column == Column::Configuration;
        if let Some(place) = layout.columns.iter().position(is_label)
            && self.issues.is_empty()
        {
            let found = unlike_poses(&self.points, &layout.names[place]);
            self.issues.extend(found);
        }
    }

    /// Refuses one point name under several groups. Of two files, only the names that are paired matter; the join looks at these.
    fn refuse_several_groups(&mut self, layout: &Layout) {
        let names = self.keys.iter().find(|(means, _)| means == "name");
        let Some((_, names)) = names.filter(|_| layout.groups.len() < 2) else {
            return;
        };
        let rows = names.iter().zip(&self.groups.of_rows).enumerate();
        let named = rows.filter(|(_, (name, _))| !name.is_empty());
        let named = named.map(|(row, (name, group))| {
            let reflector = self.reflector_cells.get(row).map_or("", String::as_str);
            let key = point_in_group(name, reflector, &self.points[row]);
            (key, group.as_str())
        });
        let found = several_groups(named);
        self.issues
            .extend(found.map(|detail| Issue::new("two_readings", detail)));
    }

    /// Refuses rows with the name of a statistic before their numbers: if all other rows begin with a number, or if they are less than a
    /// quarter of all rows and the word is not read as a label. In other files the word is part of a normal column.
    fn refuse_summaries(&mut self) {
        let is_numbered =
            self.n_numbered > 0 && self.n_numbered + self.summaries.len() == self.n_rows;
        let is_rare = 4 * self.summaries.len() < self.n_rows;
        for found in std::mem::take(&mut self.summaries) {
            let Summary {
                row,
                word,
                is_label,
            } = found;
            if is_numbered || is_rare && !is_label {
                let detail = format!(
                    "row {row} has the name {word:?}: a row of statistics is no measurement; remove it, or put # before it; if it is a point's name, name it otherwise"
                );
                self.issue(Some(row), "summary_row", detail);
            }
        }
    }

    /// Refuses columns in which only some numbers have a unit after them.
    fn refuse_some_units(&mut self, layout: &Layout) {
        for (column, units) in std::mem::take(&mut self.with_unit).into_iter().enumerate() {
            let (Some(with), Some(without)) = (units.first_with, units.first_without) else {
                continue;
            };
            let (row, code, what) = match units.n_with < units.n_without {
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
            let issue = Issue::new(code, detail)
                .in_row(row)
                .in_column((*name).to_owned());
            self.issues.push(issue);
        }
    }

    /// A cell without the unit of its column after the number.
    ///
    /// # Errors
    /// If the cell has another unit.
    fn bare<'r>(
        &mut self,
        row: usize,
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
                units.first_without.get_or_insert(row);
            }
            Some(unit) if unit == own => {
                units.n_with += 1;
                units.first_with.get_or_insert(row);
            }
            Some(unit) => {
                let name = &layout.names[column];
                let detail = format!(
                    "row {row}, column {name}: {cell:?} is not a number of this column: it is in {unit}, and the column in {own}: write the numbers in one unit, and the unit into the column's name"
                );
                return Err(Issue::new("not_a_number", detail)
                    .in_row(row)
                    .in_column((*name).to_owned()));
            }
        }
        Ok(number)
    }

    pub fn issue(&mut self, row: Option<usize>, code: &'static str, detail: String) {
        self.issues.push(Issue::new(code, detail).in_row(row));
    }

    /// Refuses the table, if there are issues. Each has the line of its row.
    ///
    /// # Errors
    /// The first issues.
    pub fn refused(&self) -> Result<(), ParseError> {
        let line = |row: usize| self.lines.get(row).copied();
        let issues = self.issues.iter().cloned().map(|issue| Issue {
            line: issue.row.and_then(line),
            ..issue
        });
        match self.issues.is_empty() {
            true => Ok(()),
            false => Err(ParseError::new(issues.collect())),
        }
    }

    /// Reads the next row. Returns false if no further rows are wanted.
    pub fn take(&mut self, next: Next, table: &Table, layout: &Layout, reading: &Reading) -> bool {
        let row = match next {
            Next::Row(row) => row,
            Next::Skipped => {
                self.n_skipped += 1;
                return true;
            }
            Next::Bad(line, code, detail) => {
                let row = self.n_rows;
                self.lines.push(line);
                self.issue(
                    Some(row),
                    code,
                    format!("row {row} cannot be read: {detail}"),
                );
                self.n_rows += 1;
                return self.issues.len() < MAX_ISSUES;
            }
        };
        if !self.groups.take(&row) {
            return true;
        }
        let index = self.n_rows;
        if index >= MAX_ROWS {
            self.issues.clear();
            let detail = format!("more than {MAX_ROWS} rows; split the campaign into several sets");
            self.issue(None, "too_many_rows", detail);
            return false;
        }
        self.n_rows += 1;
        self.lines.push(row.line);
        if let Err(detail) = self.ends.take(index, &row, table, &layout.ends) {
            self.issue(Some(index), "wrong_cell_count", detail);
            return self.issues.len() < MAX_ISSUES;
        }
        self.flags.take(index, &row);
        self.names.take(index, &row);
        let mut reflector = None;
        let mut cells = csv::StringRecord::new();
        for (column, place) in layout.places.iter().enumerate() {
            let cell = row.cells.get(*place).unwrap_or("");
            match self.bare(index, cell, column, layout) {
                Ok(cell) if is_of_target(&layout.columns[column]) && !cell.trim().is_empty() => {
                    // Reflectors are numbered at the end, when all rows are known.
                    reflector = Some(cell.trim().to_owned());
                    let is_name = layout.columns[column] == Column::TargetName;
                    cells.push_field(if is_name { cell } else { "0" });
                }
                Ok(cell) => cells.push_field(cell),
                Err(issue) => {
                    self.issues.push(issue);
                    return self.issues.len() < MAX_ISSUES;
                }
            }
        }
        let point = parse_row(
            index,
            &cells,
            &layout.names,
            &layout.columns,
            reading,
            &mut self.issues,
        );
        let leading: Vec<(&str, bool)> = layout.leading_cells(&row.cells).collect();
        let statistic = leading.iter().find(|(cell, _)| is_statistic(cell));
        if let Some((word, is_label)) = statistic {
            self.summaries.push(Summary {
                row: index,
                word: (*word).to_owned(),
                is_label: *is_label,
            });
        } else if leading.first().is_some_and(|(cell, _)| is_numeric(cell)) {
            self.n_numbered += 1;
        }
        if let Some(point) = point {
            self.points.push(point);
            self.reflector_cells.extend(reflector);
            for (used, (_, cells)) in layout.keys.iter().zip(&mut self.keys) {
                cells.push(row.cells.get(used.place).unwrap_or("").trim().to_owned());
            }
        }
        self.issues.len() < MAX_ISSUES
    }
}
