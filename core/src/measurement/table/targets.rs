//! A program as a table: finds the columns of its targets, their meanings, and the places of their cells. The table is read like a
//! measurement file. If a joint has several columns, the commanded values are used and not the measured ones.

use crate::measurement::columns::mapping::{ColumnRef, Mapping, Separator};
use crate::measurement::columns::names::{ANGLES, Known, Unit, recognise};
use crate::measurement::columns::pose_names::pose_columns;
use crate::measurement::columns::words::is_one_of;
use crate::measurement::conventions::Decimal;
use crate::measurement::csv::number_text::{value, without_unit};
use crate::measurement::issue::{ParseError, whole};
use crate::measurement::table::Table;
use crate::measurement::table::cells::cell_places;
use crate::measurement::table::columns::Needs;
use crate::measurement::table::lines::lines;
use crate::measurement::table::points::{self, TableOptions};
use crate::measurement::table::text::Source;
use std::collections::BTreeMap;
use std::ops::Range;

/// Words that distinguish commanded values from measured ones.
const COMMANDED: &str = "target|commanded|command|cmd|nominal|nom|soll|desired|setpoint|programmed|goal|reference|\
    ref";
/// Columns of a Cartesian target.
const POSITION: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
const QUATERNION: [&str; 4] = ["quat_w", "quat_x", "quat_y", "quat_z"];
const ANGLES_DEG: [&str; 3] = ["rx_deg", "ry_deg", "rz_deg"];
/// Largest relative difference between a cell and the value that was read from it.
const RELATIVE_TOLERANCE: f64 = 1e-9;

/// A column with joint values.
#[derive(Clone, Debug, PartialEq)]
pub struct JointColumn {
    /// Its index, counted from 0.
    pub place: usize,
    /// Its name in the file.
    pub name: String,
    /// Degrees in one unit.
    pub deg: f64,
}

/// A row of targets.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetRow {
    /// Its line, counted from 1.
    pub line: usize,
    /// Joint values, degrees.
    pub q_deg: Vec<f64>,
    /// The places of its cells in the text, bytes.
    pub cells: Vec<Range<usize>>,
}

/// The targets of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Targets {
    /// The column of each joint.
    pub joints: Vec<JointColumn>,
    /// Columns of the position, if targets are Cartesian.
    pub position: Option<[usize; 3]>,
    /// Columns of the quaternion.
    pub quaternion: Option<[usize; 4]>,
    /// Columns of three angles of a rotation; the convention is stated separately.
    pub angles: Option<[usize; 3]>,
    /// Names of columns with poses that belong to the joint values.
    pub other_poses: Vec<String>,
    /// The decimal mark.
    pub decimal: Decimal,
    /// The separator of its columns.
    pub separator: Separator,
    /// The rows.
    pub rows: Vec<TargetRow>,
}

/// Reads the targets of a table. `mapping` states the meanings of joint columns whose names do not show them; `stated_pose` states the
/// columns of a Cartesian target.
///
/// # Errors
/// As [`points::read`], and if the cells of a row cannot be found again in the text.
pub fn read_targets(
    source: &Source,
    mapping: &Mapping,
    stated_pose: &[(String, ColumnRef)],
) -> Result<Targets, ParseError> {
    let table = Table::find(source.clone(), mapping)?;
    let mut mapping = mapping.clone();
    let mut commanded = commanded_joints(&table, &mapping)?;
    if commanded.len() < n_joints_named(&table, &mapping).unwrap_or(0) {
        commanded.clear();
    }
    let is_stated = |means: &str| mapping.columns.iter().any(|(known, _)| known == means);
    let preferred: Vec<(String, ColumnRef)> = commanded
        .into_iter()
        .filter(|(means, _)| !is_stated(means))
        .map(|(means, place)| (means, ColumnRef::Number(place + 1)))
        .collect();
    mapping.columns.extend(preferred);
    let options = TableOptions {
        mapping: &mapping,
        // If no names show the number of joints, the columns may be the six axes S, L, U, R, B and T.
        n_joints: n_joints_named(&table, &mapping).unwrap_or(6).max(1),
        needs: Needs::Joints,
        rotation: None,
        is_time: |_| true,
        are_targets: true,
    };
    let content = points::read(source.clone(), &options)?;
    let mut joints: BTreeMap<usize, JointColumn> = BTreeMap::new();
    for (used, name) in &content.understood.columns {
        if let Some((number, unit)) = joint(&used.means)
            && let Some((_, rad)) = ANGLES.iter().find(|(name, _)| *name == unit)
        {
            let column = JointColumn {
                place: used.place,
                name: name.clone(),
                deg: rad.to_degrees(),
            };
            joints.insert(number, column);
        }
    }
    let joints: Vec<JointColumn> = joints.into_values().collect();
    // A column of a joint, or one that the mapping ignores, is not part of a pose.
    let is_free = |place: usize| {
        let ignored = mapping
            .ignore
            .iter()
            .filter_map(|column| table.place(column).ok());
        joints.iter().all(|joint| joint.place != place)
            && !ignored.into_iter().any(|own| own == place)
    };
    let named = |name: &str| {
        let mut stated = stated_pose.iter().filter(|(means, _)| means == name);
        let stated = stated.find_map(|(_, column)| table.place(column).ok());
        let mut header = table.header.iter().enumerate();
        let of_name = header
            .find(|(place, own)| own.trim().eq_ignore_ascii_case(name) && is_free(*place))
            .map(|(place, _)| place);
        stated.or(of_name)
    };
    let position = all_there(POSITION.map(named));
    let other_poses = match position {
        Some(_) => vec![],
        None => pose_columns(&table.header),
    };
    let decimal = content.understood.decimal;
    let q_deg = content.points.iter().map(|point| {
        let q_rad = point.q_rad.iter();
        q_rad.map(|q| q.to_degrees()).collect::<Vec<f64>>()
    });
    let places = Places::new(&source.text, table.separator);
    // A unit after a number is kept.
    let number = |place: Range<usize>| {
        let (number, _) = without_unit(&source.text[place.clone()]);
        place.start..place.start + number.len()
    };
    let rows = content.lines.iter().zip(q_deg).map(|(line, q_deg)| {
        let cells = places.of_line(*line);
        let is_same = |(column, q_deg): (&JointColumn, &f64)| {
            let cell = cells
                .get(column.place)
                .map(|place| &source.text[place.clone()]);
            let found = cell.and_then(|cell| value(without_unit(cell).0, decimal));
            let found = found.map(|q| q * column.deg);
            found.is_some_and(|found| {
                (found - q_deg).abs() <= RELATIVE_TOLERANCE * q_deg.abs().max(1.0)
            })
        };
        match joints.iter().zip(&q_deg).all(is_same) {
            true => Ok(TargetRow {
                line: *line,
                q_deg,
                cells: cells.into_iter().map(number).collect(),
            }),
            false => Err(not_found_again(*line)),
        }
    });
    Ok(Targets {
        rows: rows.collect::<Result<_, _>>()?,
        position,
        quaternion: all_there(QUATERNION.map(named)),
        angles: all_there(ANGLES_DEG.map(named)),
        other_poses: other_poses.iter().map(|place| table.name(*place)).collect(),
        decimal,
        separator: table.separator,
        joints,
    })
}

fn not_found_again(line: usize) -> ParseError {
    let detail = format!(
        "line {line}: its cells cannot be replaced one by one: write the file without line breaks within cells, and with line ends LF or CRLF"
    );
    whole("unreadable", detail)
}

/// Number and unit of a joint in a meaning such as `q1_deg`.
fn joint(means: &str) -> Option<(usize, &str)> {
    let (base, unit) = means.split_once('_')?;
    Some((base.strip_prefix('q')?.parse().ok()?, unit))
}

/// The meaning of a header that is marked as commanded.
fn commanded(header: &str, below: Option<Unit>) -> Known {
    let lower = header.trim().to_lowercase();
    // A field of Universal Robots' RTDE interface, which is defined to be in radians.
    if let Some(number) = lower.strip_prefix("target_q_").and_then(|n| n.parse().ok()) {
        return Known::Joint(number, Unit::Is("rad"));
    }
    let is_word = |word: &str| is_one_of(COMMANDED, word);
    let words = lower.split_inclusive(|c: char| !c.is_alphanumeric());
    let (mut rest, mut is_commanded) = (String::new(), false);
    for word in words {
        let plain = word.trim_end_matches(|c: char| !c.is_alphanumeric());
        match is_word(plain) {
            true => is_commanded = true,
            false => rest.push_str(word),
        }
    }
    let rest = rest.trim_end_matches([' ', '_', '-', '.']);
    match is_commanded {
        true => recognise(rest, below),
        false => Known::Unknown,
    }
}

/// The columns that the mapping does not ignore: index and name.
fn names<'t>(table: &'t Table, mapping: &Mapping) -> impl Iterator<Item = (usize, &'t String)> {
    let ignored = mapping.ignore.iter();
    let ignored: Vec<usize> = ignored
        .filter_map(|column| table.place(column).ok())
        .collect();
    let names = table.header.iter().enumerate();
    names.filter(move |(place, _)| !ignored.contains(place))
}

/// The columns of commanded joint values: meaning, and index of the column. Empty unless every joint has one.
///
/// # Errors
/// If a joint has two such columns, or one without a unit. Measured values must not be corrected instead.
fn commanded_joints(table: &Table, mapping: &Mapping) -> Result<Vec<(String, usize)>, ParseError> {
    let units = table.units.as_ref();
    let below = |place: usize| units.and_then(|units| units.get(place).copied().flatten());
    let names = names(table, mapping);
    let mut found: BTreeMap<usize, (usize, Unit)> = BTreeMap::new();
    for (place, name) in names {
        if let Known::Joint(number, unit) = commanded(name, below(place))
            && let Some((other, _)) = found.insert(number, (place, unit))
        {
            let detail = format!(
                "columns {} and {} are both commanded values of one joint: leave one of them aside in the column mapping: {{\"ignore\": [{:?}]}}",
                table.name(other),
                table.name(place),
                table.name(place)
            );
            return Err(whole("duplicate_column", detail));
        }
    }
    let first = found.keys().next().copied().unwrap_or(1);
    let is_whole = first <= 1 && found.keys().copied().eq(first..first + found.len());
    let column = |(number, (place, unit)): (usize, (usize, Unit))| {
        let unit = match unit {
            Unit::Is(unit) => Some(unit),
            _ => mapping.joint_unit,
        };
        let Some(unit) = unit else {
            let detail = format!(
                "column {} has commanded joint values and no unit: state it in the column mapping: {{\"joint_unit\": \"deg\"}} (or \"rad\")",
                table.name(place)
            );
            return Err(whole("missing_unit", detail));
        };
        Ok((format!("q{}_{unit}", number + 1 - first), place))
    };
    match is_whole {
        true => found.into_iter().map(column).collect(),
        false => Ok(vec![]),
    }
}

/// Number of joints according to the mapping or the names of columns.
fn n_joints_named(table: &Table, mapping: &Mapping) -> Option<usize> {
    let stated = mapping.columns.iter();
    let stated = stated.filter_map(|(means, _)| joint(means).map(|(number, _)| number));
    let known = names(table, mapping).map(|(_, name)| recognise(name, None));
    let named = known.filter_map(|known| match known {
        Known::Joint(number, _) => Some(number),
        _ => None,
    });
    let named: Vec<usize> = named.collect();
    let from_zero = usize::from(named.contains(&0));
    let named = named.into_iter().max().map(|most| most + from_zero);
    stated.max().or(named)
}

/// The places of cells in a text.
struct Places<'t> {
    text: &'t str,
    separator: Separator,
    /// Start of each line.
    starts: Vec<usize>,
}

impl<'t> Places<'t> {
    fn new(text: &'t str, separator: Separator) -> Self {
        let ends = lines(text).map(|line| line.end);
        Self {
            text,
            separator,
            starts: std::iter::once(0).chain(ends).collect(),
        }
    }

    /// The places of the cells of a line, counted from 1.
    fn of_line(&self, line: usize) -> Vec<Range<usize>> {
        let start = line.checked_sub(1).and_then(|at| self.starts.get(at));
        let Some(start) = start.copied() else {
            return vec![];
        };
        let text = lines(&self.text[start..]).next();
        let places = text.map_or(vec![], |line| cell_places(line.text, self.separator));
        let in_text = |place: Range<usize>| start + place.start..start + place.end;
        places.into_iter().map(in_text).collect()
    }
}

/// `Some` if all columns exist.
fn all_there<const N: usize>(columns: [Option<usize>; N]) -> Option<[usize; N]> {
    let all: Option<Vec<usize>> = columns.into_iter().collect();
    all?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::{Targets, read_targets};
    use crate::measurement::columns::mapping::{ColumnRef, Mapping};
    use crate::measurement::table::text::Source;

    fn targets(text: &str) -> Targets {
        let source = Source::decode(text.as_bytes()).unwrap();
        read_targets(&source, &Mapping::default(), &[]).unwrap_or_else(|e| panic!("{text}: {e:?}"))
    }

    fn columns(text: &str) -> Vec<String> {
        let joints = targets(text).joints.into_iter();
        joints.map(|joint| joint.name).collect()
    }

    #[test]
    fn a_program_means_its_commanded_joint_values() {
        assert_eq!(
            columns("Actual J1 [deg],Target J1 [deg],Actual J2 [deg],Target J2 [deg]\n1,2,3,4\n"),
            ["Target J1 [deg]", "Target J2 [deg]"]
        );
        assert_eq!(
            columns("actual_q_0 target_q_0 actual_q_1 target_q_1\n1 2 3 4\n"),
            ["target_q_0", "target_q_1"]
        );
        assert_eq!(
            columns("A1 Soll [°];A1 Ist [°];A2 Soll [°];A2 Ist [°]\n1;2;3;4\n"),
            ["A1 Soll [°]", "A2 Soll [°]"]
        );
        assert_eq!(columns("q1_measured_deg,q1_cmd_deg\n1,2\n"), ["q1_cmd_deg"]);
        // Measured values must not be corrected instead of commanded ones.
        let refused = |text: &str, mapping: &Mapping| {
            let source = Source::decode(text.as_bytes()).unwrap();
            read_targets(&source, mapping, &[]).unwrap_err().issues[0].code
        };
        let text = "Target J1,Target J2,Actual J1 [deg],Actual J2 [deg]\n1,2,3,4\n";
        assert_eq!(refused(text, &Mapping::default()), "missing_unit");
        let stated = Mapping {
            joint_unit: Some("deg"),
            ..Mapping::default()
        };
        let source = Source::decode(text.as_bytes()).unwrap();
        let found = read_targets(&source, &stated, &[]).unwrap();
        assert_eq!(found.joints[0].name, "Target J1");
        let text = "J1 cmd [deg],J2 cmd [deg],J1 ref [deg],J2 ref [deg]\n1,2,3,4\n";
        assert_eq!(refused(text, &Mapping::default()), "duplicate_column");
        // Not every joint has a commanded value.
        assert_eq!(
            columns("J1 [deg],J2 [deg],Target J1 [deg]\n1,2,3\n"),
            ["J1 [deg]", "J2 [deg]"]
        );
    }

    #[test]
    fn a_column_that_is_left_aside_is_no_joint() {
        let source = Source::decode(b"J1 [deg],J2 [deg],J3 [deg]\n1,2,3\n").unwrap();
        let mapping = Mapping {
            ignore: vec![ColumnRef::Header("J3 [deg]".into())],
            ..Mapping::default()
        };
        let found = read_targets(&source, &mapping, &[]).unwrap();
        assert_eq!(found.joints.len(), 2);
    }

    #[test]
    fn cells_of_targets_are_found_among_comments_and_poses() {
        let text = "# made offline\nName;J1 [°];X;Y;Z;A;B;C\n\nP1;\"10,5\";1;2;3;4;5;6\n# P2;3\nP3; 2 ;1;2;3;4;5;6\n";
        let found = targets(text);
        assert_eq!(found.other_poses, ["X", "Y", "Z", "A", "B", "C"]);
        let rows = found.rows.iter();
        let rows: Vec<(usize, &str)> = rows
            .map(|row| (row.line, &text[row.cells[1].clone()]))
            .collect();
        assert_eq!(rows, [(4, "10,5"), (6, "2")]);
        assert!((found.rows[0].q_deg[0] - 10.5).abs() < 1e-12);
        let text = "J1 [deg],note\n43.5°,2 m\n";
        assert_eq!(&text[targets(text).rows[0].cells[0].clone()], "43.5");
        // A cell with a line break.
        let text = "note,J1 [deg]\n\"a\nb\",1\n";
        let source = Source::decode(text.as_bytes()).unwrap();
        let error = read_targets(&source, &Mapping::default(), &[]).unwrap_err();
        assert!(error.issues[0].detail.contains("line 2"), "{error:?}");
    }
}
