//! Reads measurements from tables of any form. Columns are found by mapping and by name; cells are parsed like those of CSV files.

use crate::measurement::columns::column::Column;
use crate::measurement::columns::mapping::{Mapping, Separator};
use crate::measurement::columns::meaning::{self, key};
use crate::measurement::columns::pose::{PoseColumn, header_issues};
use crate::measurement::columns::pose_names::rotation_columns;
use crate::measurement::conventions::Decimal;
use crate::measurement::csv::Reading;
use crate::measurement::issue::{Issue, ParseError};
use crate::measurement::programs::Unread;
use crate::measurement::rotation_convention::RotationConvention;
use crate::measurement::set::Point;
use crate::measurement::table::Table;
use crate::measurement::table::checks::external_columns::moving_axis;
use crate::measurement::table::checks::row_ends::Ends;
use crate::measurement::table::columns::{Columns, Needs, Used, resolve};
use crate::measurement::table::decimal_mark::decimal_mark;
use crate::measurement::table::rows::{Layout, Rows};
use crate::measurement::table::text::{Encoding, Source};

/// Longest name of a point, characters; longer ones are cut.
const MAX_NAME: usize = 100;

/// How a file was interpreted: everything that is needed to read it again in the same way.
#[derive(Clone, Debug, PartialEq)]
pub struct Understood {
    /// The column separator.
    pub separator: Separator,
    /// The decimal mark.
    pub decimal: Decimal,
    /// The encoding.
    pub encoding: Encoding,
    /// The sheet, if the file is a workbook.
    pub sheet: Option<String>,
    /// The line of the header, counted from 1.
    pub header_row: Option<usize>,
    /// Whether unclosed quotes were read as plain characters, or cells with line breaks were joined.
    pub plain_quotes: bool,
    /// Whether lines that begin with a comment sign are comments, as in [`Table::comments`].
    pub comments: Option<bool>,
    /// The columns that are read, with their names in the file.
    pub columns: Vec<(Used, String)>,
    /// The names of the columns that are not read.
    pub ignored: Vec<String>,
    /// Number of lines that are not data: blank lines, comments, units, and lines above the header.
    pub skipped_rows: usize,
    /// The names of the reflectors (targets) in the order of their numbers, if the file has names.
    pub reflectors: Vec<String>,
    /// Points of a robot's program that are not read.
    pub unread: Vec<Unread>,
    /// The groups of points that are read, as the caller stated them; empty for all.
    pub groups: Vec<String>,
    /// Number of rows of other groups.
    pub n_other_groups: usize,
}

/// The content of a table.
#[derive(Clone, Debug)]
pub struct Content {
    /// The points. In a file with only joint values or only positions, the missing values are zero.
    pub points: Vec<Point>,
    /// The line of each point.
    pub lines: Vec<usize>,
    /// The join keys: for each column `name`, `number` or `time`, its meaning and its cells.
    pub keys: Vec<(String, Vec<String>)>,
    /// The group of each point in an instrument's file; empty if it has none.
    pub groups: Vec<String>,
    /// How the table was interpreted.
    pub understood: Understood,
}

/// Options for reading a table.
#[derive(Clone, Copy, Debug)]
pub struct TableOptions<'a> {
    /// The column mapping of the caller.
    pub mapping: &'a Mapping,
    /// The robot's number of links.
    pub n_joints: usize,
    /// The columns that the table must have.
    pub needs: Needs,
    /// The rotation convention of poses.
    pub rotation: Option<RotationConvention>,
    /// Check of the text in `measured_at`.
    pub is_time: fn(&str) -> bool,
    /// Whether the rows are targets of a program. Then no rows are refused as statistics or duplicates, and joint values may be any
    /// numbers.
    pub are_targets: bool,
}

/// Preview of a table.
#[derive(Clone, Debug)]
pub struct Preview {
    /// The cells of the header; empty texts if there is no header.
    pub header: Vec<String>,
    /// The cells of the line above the header.
    pub above: Vec<String>,
    /// The first rows.
    pub rows: Vec<Vec<String>>,
    /// How the table is interpreted so far.
    pub understood: Understood,
    /// The meanings of its columns, and the errors in them.
    pub columns: Columns,
}

/// Reads a table.
///
/// # Errors
/// [`ParseError`] with the line, the row, the column and a hint for each error.
pub fn read(source: Source, options: &TableOptions) -> Result<Content, ParseError> {
    let table = Table::find(source, options.mapping)?;
    let columns = resolved(&table, options);
    if !columns.issues.is_empty() {
        return Err(ParseError::new(columns.issues));
    }
    let parts = Parts::new(&table, &columns, options);
    let decimal = parts.decimal(options.mapping)?;
    let mut understood = parts.understood(&columns, decimal, options);
    let reading = Reading {
        n_joints: options.n_joints,
        decimal,
        rotation: options.rotation,
        is_time: options.is_time,
    };
    let mut content = Rows::new(&table, &parts.layout);
    table.each_row(|next| content.take(next, &table, &parts.layout, &reading));
    content.refuse_no_measurements(&table, &parts.layout);
    content.number_reflectors(&parts.layout);
    if content.points.is_empty() && content.issues.is_empty() {
        content.issue(
            None,
            "no_rows",
            "the file has a header but no data rows".into(),
        );
    }
    content.refused()?;
    understood.skipped_rows += content.n_skipped;
    understood.n_other_groups = content.groups.n_other;
    understood.reflectors = content.reflectors;
    let mut points = content.points;
    for (point, line) in points.iter_mut().zip(&content.lines) {
        point.line = Some(*line);
    }
    let names = content.keys.iter().find(|(means, _)| means == "name");
    for (point, name) in points
        .iter_mut()
        .zip(names.map_or(&[][..], |(_, cells)| cells))
    {
        point.name = name_in_one_line(name);
    }
    Ok(Content {
        points,
        lines: content.lines,
        keys: content.keys,
        groups: content.groups.of_rows,
        understood,
    })
}

/// Resolves the columns of a table. The issues include errors in the combination of pose columns.
fn resolved(table: &Table, options: &TableOptions) -> Columns {
    let mut columns = resolve(table, options.mapping, options.n_joints, options.needs);
    let is_used = |name: &str| columns.used.iter().any(|used| used.means == name);
    if columns.issues.is_empty() && is_used("target") && is_used("target_name") {
        columns.issues.push(
            Issue::new(
                "duplicate_column",
                "target and target_name both say the reflector: leave one of them out",
            )
            .in_column("target".to_owned()),
        );
    }
    // Points of a stored file, which was accepted once, are all read.
    let program = table
        .program
        .as_ref()
        .filter(|_| !options.mapping.is_complete);
    if let Some(moving) = program.and_then(|program| program.moving_axis.clone()) {
        columns.issues = vec![Issue::new("external_axis_moves", moving)];
    }
    if options.needs != Needs::Positions
        && !options.mapping.is_complete
        && columns.issues.is_empty()
    {
        let is_ignored = |place: usize| {
            let ignored = options.mapping.ignore.iter();
            let mut ignored = ignored.filter_map(|column| table.place(column).ok());
            ignored.any(|one| one == place)
        };
        let is_free = |place: usize| {
            !is_ignored(place) && columns.used.iter().all(|used| used.place != place)
        };
        let moving = moving_axis(table, is_free, options.n_joints);
        columns.issues.extend(moving);
    }
    if options.needs != Needs::Joints && columns.issues.is_empty() {
        let has = |name: &str| columns.used.iter().any(|used| used.means == name);
        let of_poses = header_issues(&has, options.rotation).into_iter();
        columns.issues = of_poses
            .map(|(column, code, detail)| Issue::new(code, detail).in_column(column))
            .collect();
        if options.rotation.is_some() && !has("rx_deg") {
            for issue in &mut columns.issues {
                issue.detail = named_rotation(table).unwrap_or(issue.detail.clone());
            }
        }
    }
    columns
}

/// The refusal of a stated convention if the table has a rotation under other names.
fn named_rotation(table: &Table) -> Option<String> {
    let places = rotation_columns(&table.header)?;
    let names = places.map(|place| table.reference(place));
    Some(format!(
        "a convention of rotations is stated, and no column is read as rx_deg, ry_deg and rz_deg: if it is these, say so in the column mapping: \
         {{\"rx_deg\": {}, \"ry_deg\": {}, \"rz_deg\": {}}}, if they are in degrees",
        names[0], names[1], names[2]
    ))
}

/// Makes a preview of a table: its first rows and the meanings of its columns.
///
/// # Errors
/// [`ParseError`] if not even the columns can be separated.
pub fn preview(
    source: Source,
    options: &TableOptions,
    n_rows: usize,
) -> Result<Preview, ParseError> {
    let table = Table::find(source, options.mapping)?;
    let columns = resolved(&table, options);
    let parts = Parts::new(&table, &columns, options);
    let decimal = parts.decimal(options.mapping).unwrap_or(Decimal::Point);
    let understood = parts.understood(&columns, decimal, options);
    Ok(Preview {
        header: table.header.clone(),
        above: table.above.clone(),
        rows: table.first_rows(n_rows, 100 * n_rows),
        understood,
        columns,
    })
}

/// A table, and the columns that are read.
struct Parts<'t> {
    table: &'t Table<'t>,
    layout: Layout,
}

impl<'t> Parts<'t> {
    fn new(table: &'t Table<'t>, columns: &Columns, options: &TableOptions) -> Self {
        let wanted = |used: &&Used| match options.needs {
            Needs::Joints => used.means.starts_with('q'),
            Needs::Positions => !is_joint(&used.means),
            Needs::Points => true,
        };
        let read: Vec<(usize, Column, Option<&'static str>)> = columns
            .used
            .iter()
            .filter(wanted)
            .filter_map(|used| {
                let column = meaning::column(&used.means, options.n_joints)?;
                Some((used.place, column, meaning::unit(&used.means)))
            })
            .collect();
        let keys = columns
            .used
            .iter()
            .filter(|used| key(&used.means).is_some());
        let keyed = keys.clone().map(|used| used.place + 1).max().unwrap_or(0);
        let ignored: Vec<usize> = (options.mapping.ignore.iter())
            .filter_map(|column| table.place(column).ok())
            .collect();
        let is_wanted = |place: &usize| {
            // For a stored file, which was accepted once, only the columns that are read matter.
            let is_named = !table.header[*place].is_empty() && !options.mapping.is_complete;
            is_named && !ignored.contains(place)
        };
        let named = (0..table.header.len()).rev().find(is_wanted);
        let named = named.map_or(0, |place| place + 1);
        let last = read.iter().map(|(place, ..)| place + 1).max();
        let last = last.unwrap_or(0).max(keyed);
        let layout = Layout {
            names: read.iter().map(|(place, ..)| table.name(*place)).collect(),
            places: read.iter().map(|(place, ..)| *place).collect(),
            columns: read.iter().map(|(_, column, _)| *column).collect(),
            keys: keys.cloned().collect(),
            ends: Ends {
                n_named: named.max(last),
                n_read: last,
                are_left_aside: !options.mapping.is_complete
                    && ignored.iter().any(|place| *place >= last),
                is_open: table.is_open,
                ends_with_number: read
                    .iter()
                    .any(|(place, column, _)| place + 1 == last && is_number(column)),
                has_places: matches!(table.encoding, Encoding::Xlsx | Encoding::Ods),
                positions: read
                    .iter()
                    .filter(|(_, column, _)| matches!(column, Column::Position(..)))
                    .map(|(place, ..)| *place)
                    .collect(),
                first_joint: (columns.used.iter())
                    .find(|used| is_joint(&used.means))
                    .filter(|used| !used.is_mapped && !options.are_targets)
                    .map(|used| (used.place, used.means.clone())),
            },
            ignored,
            units: read.iter().map(|(.., unit)| *unit).collect(),
            is_read_again: options.mapping.is_complete,
            has_positions: options.needs != Needs::Joints,
            are_targets: options.are_targets,
            groups: options.mapping.groups.clone(),
        };
        Self { table, layout }
    }

    fn decimal(&self, mapping: &Mapping) -> Result<Decimal, ParseError> {
        if let Some(decimal) = mapping.decimal {
            return Ok(decimal);
        }
        if self.table.encoding == Encoding::Program {
            return Ok(Decimal::Point);
        }
        let numbers: Vec<(usize, Option<Column>)> = self
            .layout
            .places
            .iter()
            .zip(&self.layout.columns)
            .filter(|(_, column)| is_number(column))
            .map(|(place, column)| (*place, Some(*column)))
            .collect();
        decimal_mark(self.table, &numbers)
    }

    fn understood(
        &self,
        columns: &Columns,
        decimal: Decimal,
        options: &TableOptions,
    ) -> Understood {
        let is_used = |used: &&Used| {
            self.layout.places.contains(&used.place)
                || matches!(used.means.as_str(), "name" | "group" | "collection")
                || key(&used.means).is_some() && (options.needs != Needs::Points || used.is_mapped)
        };
        let used: Vec<Used> = columns.used.iter().filter(is_used).cloned().collect();
        let is_ignored = |place: &usize| {
            !self.table.header[*place].is_empty() && used.iter().all(|used| used.place != *place)
        };
        let ignored = (0..self.table.header.len()).filter(is_ignored);
        Understood {
            separator: self.table.separator,
            decimal,
            encoding: self.table.encoding,
            sheet: options.mapping.sheet.clone(),
            header_row: self.table.header_line,
            plain_quotes: self.table.plain_quotes,
            comments: self.table.comments,
            ignored: ignored.map(|place| self.table.name(place)).collect(),
            columns: used
                .into_iter()
                .map(|used| {
                    let name = self.table.name(used.place);
                    (used, name)
                })
                .collect(),
            skipped_rows: self.table.n_skipped_above + usize::from(self.table.units.is_some()),
            reflectors: vec![],
            unread: self
                .table
                .program
                .as_ref()
                .map_or(vec![], |program| program.unread.clone()),
            groups: match options.needs {
                Needs::Joints => vec![],
                _ => options.mapping.groups.clone(),
            },
            n_other_groups: 0,
        }
    }
}

/// Whether the cells of a column are numbers.
fn is_number(column: &Column) -> bool {
    match column {
        Column::OfPose(column) => *column != PoseColumn::Kind,
        Column::Joint(..) | Column::Position(..) | Column::StdMm | Column::TemperatureC => true,
        _ => false,
    }
}

fn is_joint(means: &str) -> bool {
    let base = means.split_once('_').map_or(means, |(base, _)| base);
    base.strip_prefix('q')
        .is_some_and(|rest| rest.parse::<usize>().is_ok())
}

/// A point's name for tables and texts: in one line, of bounded length. `None` if it is empty.
pub fn name_in_one_line(cell: &str) -> Option<String> {
    let plain = |c: char| if c.is_control() { ' ' } else { c };
    let name: String = cell.chars().take(MAX_NAME).map(plain).collect();
    Some(name).filter(|name| !name.is_empty())
}
