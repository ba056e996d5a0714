//! Converts the cells of a row to a measured point. Nothing is corrected silently.

use crate::measurement::columns::column::Column;
use crate::measurement::columns::pose::{
    MAX_ROTATION_RAD, MAX_STD_ROTATION_RAD, MIN_STD_ROTATION_RAD, PoseCells, PoseColumn,
};
use crate::measurement::conventions::{Decimal, Subset};
use crate::measurement::csv::number_text;
use crate::measurement::issue::Issue;
use crate::measurement::position_noise::{MAX_STD_MM, MIN_STD_MM};
use crate::measurement::rotation_convention::RotationConvention;
use crate::measurement::set::Point;
use std::borrow::Cow;

/// Maximum number of rows of a set: a hundred times the largest known data set. An identification from so many rows takes half a minute.
pub const MAX_ROWS: usize = 100_000;
/// Largest absolute measured coordinate, mm. Laser trackers reach 80 m.
pub const MAX_COORDINATE_MM: f64 = 100_000.0;
/// Largest absolute joint value, rad: ten turns.
pub const MAX_JOINT_RAD: f64 = 20.0 * std::f64::consts::PI;
/// Maximum number of reflectors on one tool.
pub const MAX_TARGETS: usize = 32;
/// Largest absolute temperature, °C.
pub const MAX_TEMPERATURE_C: f64 = 1000.0;
/// Maximum length of a label (configuration, station, session), bytes.
pub const MAX_LABEL_LENGTH: usize = 200;

/// Examples of a time with its offset from UTC, for messages.
pub const EXAMPLE_OF_A_TIME: &str = "2026-03-01T08:15:30Z or 2026-03-01T09:15:30+01:00 (RFC 3339)";

/// Reads the cells of a row to a point. `header` has the names of `columns`.
pub fn parse_row(
    row: usize,
    record: &csv::StringRecord,
    header: &csv::StringRecord,
    columns: &[Column],
    reading: &Reading,
    issues: &mut Vec<Issue>,
) -> Option<Point> {
    let mut point = Point::empty(reading.n_joints, row);
    let before = issues.len();
    let mut of_pose = PoseCells::default();
    for ((cell, column), name) in record.iter().zip(columns).zip(header) {
        let filled = match column {
            Column::OfPose(column) => fill_pose(&mut of_pose, *column, cell.trim(), reading),
            column => fill(&mut point, *column, cell.trim(), reading),
        };
        if let Err((code, detail)) = filled {
            let is_header = !cell.trim().is_empty() && name.starts_with(cell.trim());
            let detail = match is_header {
                true => format!(
                    "{cell:?} is the name of the column: remove the line if the header stands here again; rows in another unit, or measured in another session, belong into a \
                     file of their own"
                ),
                false => detail,
            };
            let detail = format!("row {row}, column {name}: {detail}");
            issues.push(
                Issue::new(code, detail)
                    .in_row(row)
                    .in_column(name.to_string()),
            );
        }
    }
    if issues.len() == before
        && let Err((column, code, detail)) = of_pose.finish(&mut point, reading.rotation)
    {
        let detail = format!("row {row}, column {column}: {detail}");
        issues.push(
            Issue::new(code, detail)
                .in_row(row)
                .in_column(column.to_owned()),
        );
    }
    (issues.len() == before).then_some(point)
}

/// Possible reason for a row with too few cells.
const CELL_IS_MISSING: &str = "a cell or the end of the row is missing: was the file cut off or the row written in part? If it is no row, remove it, or put # before it";

/// Message for a row whose number of cells differs from the header, with a possible reason.
pub fn wrong_cell_count(
    row: usize,
    record: &csv::StringRecord,
    n_columns: usize,
    separator: u8,
) -> String {
    let other = if separator == b',' { ';' } else { ',' };
    let is_cut = record.len() < n_columns;
    let hint = match separator {
        _ if is_cut
            && record.iter().filter(|cell| cell.contains(other)).count() == record.len() =>
        {
            "are its cells separated otherwise than the header's?"
        }
        _ if is_cut => CELL_IS_MISSING,
        b',' => "a decimal comma makes extra cells: write 12.5, not 12,5",
        b';' => "is there a ';' too many?",
        _ => "is there a separator too many?",
    };
    let more = match record.len() == n_columns + 1 {
        true => "; or does the header lack a name, for example over the numbers of the rows?",
        false => "",
    };
    format!(
        "row {row} has {} cells, the header has {n_columns}; {hint}{more}",
        record.len()
    )
}

type CellError = (&'static str, String);

/// Options for reading the cells of a row.
pub struct Reading {
    pub n_joints: usize,
    pub decimal: Decimal,
    pub rotation: Option<RotationConvention>,
    pub is_time: fn(&str) -> bool,
}

/// Reads the cell of a [`PoseColumn`].
fn fill_pose(
    cells: &mut PoseCells,
    column: PoseColumn,
    cell: &str,
    reading: &Reading,
) -> Result<(), CellError> {
    let degree = std::f64::consts::PI / 180.0;
    let (factor, least, most) = match column {
        // The length of the whole quaternion is checked instead; this is stricter than limits for single components.
        PoseColumn::Quaternion(_) => (1.0, f64::NEG_INFINITY, f64::INFINITY),
        PoseColumn::Angle(_) => (degree, f64::NEG_INFINITY, MAX_ROTATION_RAD),
        PoseColumn::StdAxis(_) => (1.0, MIN_STD_MM, MAX_STD_MM),
        PoseColumn::Covariance(_) => (1.0, f64::NEG_INFINITY, MAX_STD_MM * MAX_STD_MM),
        PoseColumn::StdRotationAxis(_) | PoseColumn::StdRotation => {
            (degree, MIN_STD_ROTATION_RAD, MAX_STD_ROTATION_RAD)
        }
        PoseColumn::Kind => {
            cells.set_kind(&label(cell)?);
            return Ok(());
        }
    };
    let value = number(cell, reading.decimal, factor, most)?;
    if value < least {
        let detail = format!("{cell} is not a standard uncertainty; it has to be positive");
        return Err(("out_of_range", detail));
    }
    cells.set(column, value);
    Ok(())
}

fn fill(point: &mut Point, column: Column, cell: &str, reading: &Reading) -> Result<(), CellError> {
    let number = |cell, factor, limit| number(cell, reading.decimal, factor, limit);
    match column {
        Column::Joint(joint, factor) => {
            let value = number(cell, factor, MAX_JOINT_RAD);
            point.q_rad[joint] = value.map_err(|(code, detail)| match code {
                "out_of_range" => (code, format!("{detail}; {PULSES}")),
                _ => (code, detail),
            })?;
        }
        Column::Position(axis, factor) => {
            point.position_mm[axis] = number(cell, factor, MAX_COORDINATE_MM)?
        }
        Column::Configuration => point.configuration = label(cell)?,
        Column::Target => point.target = index(cell, MAX_TARGETS - 1)?,
        Column::TargetName => point.target_name = Some(label(cell)?),
        Column::Subset => point.subset = subset(cell)?,
        Column::MeasuredAt => {
            let time = label(cell)?;
            if !(reading.is_time)(&time) {
                return Err((
                    "not_a_time",
                    format!("{cell:?} is not a time; write it as {EXAMPLE_OF_A_TIME}"),
                ));
            }
            point.measured_at = Some(time);
        }
        Column::StdMm => {
            let std = number(cell, 1.0, MAX_STD_MM)?;
            if std < MIN_STD_MM {
                return Err((
                    "out_of_range",
                    format!(
                        "{cell} is not a standard uncertainty; it must be at least {MIN_STD_MM} mm"
                    ),
                ));
            }
            point.std_mm = Some(std);
        }
        Column::Station => point.station = Some(label(cell)?),
        Column::Session => point.session = Some(label(cell)?),
        Column::Sequence => point.sequence = number(cell, 1.0, 1.0e12)? as i64,
        Column::TemperatureC => point.temperature_c = Some(number(cell, 1.0, MAX_TEMPERATURE_C)?),
        Column::SweepJoint => {
            let joint = index(cell, reading.n_joints)?;
            if joint == 0 {
                return Err(("out_of_range", "joints are counted from 1".into()));
            }
            point.sweep_joint = Some(joint);
        }
        // `fill_pose` reads these columns.
        Column::OfPose(_) => {}
    }
    Ok(())
}

/// Texts in cells that mean that nothing was measured.
const MISSING_VALUES: [&str; 8] = ["-", "--", "n/a", "na", "nan", "null", "none", "#n/a"];
/// Advice for joint values beyond the range of any joint.
pub const PULSES: &str =
    "if these are pulses of motors or counts of encoders, convert them to degrees";
/// Advice for a row without a number.
const REMOVE: &str = "remove the row, or put # before it";

fn not_a_number(cell: &str) -> String {
    let is_nothing = MISSING_VALUES.contains(&cell.to_lowercase().as_str());
    let condition = match (is_nothing, cell.contains(['\'', '′', '"', '″'])) {
        (true, _) => "",
        (false, true) => {
            "write degrees with decimals in place of minutes and seconds, and no quotes; or "
        }
        (false, false) => "if it is no measurement, ",
    };
    format!("{cell:?} is not a number; {condition}{REMOVE}")
}

fn number(cell: &str, decimal: Decimal, factor: f64, limit: f64) -> Result<f64, CellError> {
    if cell.is_empty() {
        return Err((
            "empty_cell",
            "the cell is empty; remove the row or fill it in".into(),
        ));
    }
    let cell = &*number_text::plain(cell, if decimal == Decimal::Comma { ',' } else { '.' });
    let with_point = match decimal {
        Decimal::Point if cell.contains(',') => {
            return Err((
                "decimal_comma",
                format!("{cell:?} has a comma; write the number with a decimal point"),
            ));
        }
        Decimal::Comma if cell.contains('.') => {
            return Err((
                "decimal_point",
                format!(
                    "{cell:?} has a point, but the numbers of this file have decimal commas; write it with a comma, and without separators of thousands"
                ),
            ));
        }
        Decimal::Point => Cow::Borrowed(cell),
        Decimal::Comma => Cow::Owned(cell.replace(',', ".")),
    };
    let value: f64 = with_point
        .parse()
        .map_err(|_| ("not_a_number", not_a_number(cell)))?;
    if !value.is_finite() {
        let detail = format!("{cell:?} is not a finite number; {REMOVE}");
        return Err(("not_finite", detail));
    }
    let scaled = value * factor;
    if scaled.abs() > limit {
        return Err((
            "out_of_range",
            format!("{cell} is beyond what can be meant; check the column's unit"),
        ));
    }
    Ok(scaled)
}

fn index(cell: &str, largest: usize) -> Result<usize, CellError> {
    cell.parse().ok().filter(|i| *i <= largest).ok_or_else(|| {
        (
            "not_an_index",
            format!("{cell:?} is not a whole number from 0 to {largest}"),
        )
    })
}

fn label(cell: &str) -> Result<String, CellError> {
    if cell.is_empty() {
        return Err((
            "empty_cell",
            "the cell is empty; give every row its label, or leave the column out".into(),
        ));
    }
    if cell.len() > MAX_LABEL_LENGTH {
        return Err((
            "label_too_long",
            format!("the label is longer than {MAX_LABEL_LENGTH} bytes"),
        ));
    }
    Ok(cell.to_string())
}

fn subset(cell: &str) -> Result<Option<Subset>, CellError> {
    match cell {
        "identify" => Ok(Some(Subset::Identify)),
        "verify" => Ok(Some(Subset::Verify)),
        _ => Err((
            "unknown_subset",
            format!("{cell:?} is neither identify nor verify"),
        )),
    }
}
