//! A program with joint or Cartesian targets, as a table: reads it, and writes it again with corrected targets. Everything else stays as it is, to the
//! byte.

use super::failure::Refused;
use super::files::{self, cannot_be_used};
use super::usage::Usage;
use crate::measurement::Decimal;
use crate::measurement::column_mapping::Separator;
use crate::measurement::number_text::value;
use crate::measurement::programs;
use crate::measurement::table_targets::{Targets, read_targets};
use crate::measurement::table_text::{Encoding, Source, encoded, has_mark};
use crate::wire::columns::{ColumnsBody, FilePart};
use crate::wire::compensate::{CartesianTarget, CompensateAnswer};
use crate::wire::issue::{Invalid, Issue};
use crate::wire::{table_upload, workbook};
use std::ops::Range;
use std::path::Path;

/// A target of a program.
#[derive(Clone)]
pub enum ProgramTarget {
    Joints(Vec<f64>),
    Cartesian(CartesianTarget),
}

/// A target, and where its numbers are in the text.
struct Place {
    target: ProgramTarget,
    /// The line of the program on which it begins, counted from 1.
    line: usize,
    joints: Vec<Range<usize>>,
    position: Option<[Range<usize>; 3]>,
    quaternion: Option<[Range<usize>; 4]>,
}

/// A program.
pub struct Program {
    text: String,
    encoding: Encoding,
    has_mark: bool,
    places: Vec<Place>,
    /// The name of each joint's column.
    columns: Vec<String>,
    /// Degrees in one unit of the joint values.
    deg: f64,
    decimal: Decimal,
    separator: Separator,
    /// What the user has to know about how it was read.
    pub notes: Vec<String>,
}

impl Program {
    /// Reads a program. `columns` states what the names of a table's columns do not.
    pub fn parse(path: &Path, bytes: &[u8], columns: &ColumnsBody) -> anyhow::Result<Self> {
        let unusable = |invalid: Invalid| Usage(cannot_be_used(path, &invalid.issues));
        let refused = |error| unusable(table_upload::table_error(&error));
        let mut mapping = columns.mapping(FilePart::Robot).map_err(unusable)?;
        let is_workbook = workbook::workbook(bytes).is_some();
        let source = match workbook::workbook(bytes) {
            Some(kind) => {
                let (source, sheet) =
                    workbook::read(kind, bytes, mapping.sheet.as_deref()).map_err(unusable)?;
                mapping.sheet = Some(sheet);
                source
            }
            None => Source::decode(bytes).map_err(|error| refused(error.into()))?,
        };
        if !is_workbook && programs::find(&source.text).map_or(true, |found| found.is_some()) {
            let text = format!(
                "{}: a robot program is not corrected in place: which of its points are targets, and of which tool, its text does not say. Write the joint \
                 values of its targets as a table with the columns q1_deg, q2_deg and so on, and correct that",
                path.display()
            );
            return Err(Usage(text).into());
        }
        let targets = read_targets(&source, &mapping).map_err(refused)?;
        let mut program = Self::of_table(source, has_mark(bytes), targets)
            .map_err(|error| Usage(format!("{}: {error}", path.display())))?;
        if is_workbook {
            let note = "the workbook is written as text with tabs between its columns";
            program.notes.push(note.into());
        }
        Ok(program)
    }

    fn of_table(source: Source, has_mark: bool, targets: Targets) -> Result<Self, String> {
        let text = source.text.into_owned();
        let joints = &targets.joints;
        let deg = joints.first().map_or(1.0, |joint| joint.deg);
        let names: Vec<String> = joints.iter().map(|joint| joint.name.clone()).collect();
        let of_poses = match (targets.position, targets.quaternion) {
            (Some(_), Some(_)) => ", and the position and quaternion of each target",
            (Some(_), None) => ", and the position of each target",
            (None, _) => "",
        };
        let mut notes = vec![format!("corrected columns: {}{of_poses}", names.join(", "))];
        if !targets.other_poses.is_empty() {
            notes.push(format!(
                "warning (poses_left): columns {} stay as they are: they are the pose of the joint values before the correction",
                targets.other_poses.join(", ")
            ));
        }
        let rows = targets.rows.into_iter().map(|row| {
            let cell = |column: usize| row.cells.get(column).cloned().unwrap_or_default();
            let number = |place: &Range<usize>| {
                let cell = &text[place.clone()];
                value(cell, targets.decimal)
                    .ok_or_else(|| format!("line {}: {cell:?} is not a number", row.line))
            };
            let position = targets.position.map(|columns| columns.map(cell));
            let quaternion = targets.quaternion.filter(|_| position.is_some());
            let quaternion = quaternion.map(|columns| columns.map(cell));
            let target = match &position {
                None => ProgramTarget::Joints(row.q_deg),
                Some(position) => ProgramTarget::Cartesian(CartesianTarget {
                    position_mm: numbers(position, number)?,
                    quaternion: match &quaternion {
                        Some(quaternion) => Some(numbers(quaternion, number)?),
                        None => None,
                    },
                    rotation: None,
                    q_near_deg: row.q_deg,
                }),
            };
            Ok(Place {
                target,
                line: row.line,
                joints: joints.iter().map(|joint| cell(joint.place)).collect(),
                position,
                quaternion,
            })
        });
        Ok(Self {
            places: rows.collect::<Result<_, String>>()?,
            encoding: source.encoding,
            has_mark,
            columns: names,
            deg,
            decimal: targets.decimal,
            separator: targets.separator,
            notes,
            text,
        })
    }

    /// The targets in their order.
    pub fn targets(&self) -> Vec<ProgramTarget> {
        let places = self.places.iter();
        places.map(|place| place.target.clone()).collect()
    }

    /// The lines of targets, which are counted from 0.
    pub fn lines(&self, targets: &[usize]) -> String {
        let places = targets.iter().filter_map(|target| self.places.get(*target));
        let lines: Vec<String> = places.map(|place| place.line.to_string()).collect();
        lines.join(", ")
    }

    /// Rewrites an error in terms of the program's lines and columns, and of options. `first` is the first target of the request.
    pub fn with_file_rows(&self, error: anyhow::Error, path: &Path, first: usize) -> anyhow::Error {
        let issues = match (
            error.downcast_ref::<Refused>(),
            error.downcast_ref::<Invalid>(),
        ) {
            (Some(refused), _) if refused.is_usage() => &refused.problem.errors,
            (_, Some(invalid)) => &invalid.issues,
            _ => return error,
        };
        if issues.is_empty() {
            return error;
        }
        let mut faults: Vec<String> = issues
            .iter()
            .map(|issue| self.fault(issue, first))
            .collect();
        // A missing column is reported once per row.
        faults.dedup();
        Usage(format!("{}: {}", path.display(), faults.join("\n  "))).into()
    }

    fn fault(&self, issue: &Issue, first: usize) -> String {
        let detail = &issue.detail;
        let pointer = issue.pointer.as_deref().unwrap_or_default();
        let mut pointer = pointer.split('/').skip(1);
        let (field, row, joint) = (pointer.next(), pointer.next(), pointer.next());
        let place = row.and_then(|row| self.places.get(first + row.parse::<usize>().ok()?));
        let joint = joint.and_then(|joint| joint.parse::<usize>().ok());
        let column = joint.and_then(|joint| self.columns.get(joint));
        match (field, place, joint) {
            (Some("q_deg"), Some(place), Some(joint)) => match column {
                Some(name) => format!("line {}, column {name}: {detail}", place.line),
                None => format!("line {}, joint {}: {detail}", place.line, joint + 1),
            },
            (Some("targets"), Some(place), _) => format!("line {}: {detail}", place.line),
            (Some("frame"), ..) => format!("--frame: {detail}"),
            (Some("tool_name"), ..) => format!("--tool: {detail}"),
            (Some("q_deg"), ..) => {
                let n = self.places.first().map_or(0, |place| place.joints.len());
                format!("it has joint values of {n} joints: {detail}")
            }
            (Some("mode"), ..) => format!("--mode: {detail}"),
            (Some("base"), ..) => format!("--base: {detail}"),
            (Some("target"), ..) => format!("--target: {detail}"),
            (Some("tool"), ..) => format!("--tool-mm: {detail}"),
            _ => files::fault(issue),
        }
    }

    /// The program with corrected targets, in its own encoding.
    pub fn with(&self, answer: &CompensateAnswer) -> Vec<u8> {
        let mut replaced: Vec<(&Range<usize>, String)> = Vec::new();
        for (i, (place, q_deg)) in self.places.iter().zip(&answer.q_deg).enumerate() {
            let angles = place.joints.iter().zip(q_deg);
            replaced.extend(angles.map(|(at, q_deg)| (at, self.angle(at, *q_deg))));
            if let Some(pose) = answer.poses.as_ref().and_then(|poses| poses.get(i)) {
                let position = place.position.iter().flatten().zip(pose.position_mm);
                replaced.extend(position.map(|(at, mm)| (at, self.marked(at, format!("{mm:.5}")))));
                let quaternion = place.quaternion.iter().flatten().zip(pose.quaternion);
                replaced.extend(quaternion.map(|(at, q)| (at, self.marked(at, format!("{q:.9}")))));
            }
        }
        replaced.sort_by_key(|(at, _)| at.start);
        let mut text = String::with_capacity(self.text.len() + 8 * replaced.len());
        let mut from = 0;
        for (at, number) in replaced {
            text.push_str(&self.text[from..at.start]);
            text.push_str(&number);
            from = at.end;
        }
        text.push_str(&self.text[from..]);
        encoded(&text, self.encoding, self.has_mark)
    }

    fn angle(&self, at: &Range<usize>, q_deg: f64) -> String {
        self.marked(
            at,
            // at least 2e-7 degrees in each unit
            match self.deg > 10.0 {
                true => format!("{:.9}", q_deg / self.deg),
                false => format!("{:.7}", q_deg / self.deg),
            },
        )
    }

    /// A number with the program's decimal mark. In a table whose separator is that mark, it is in quotes.
    fn marked(&self, at: &Range<usize>, number: String) -> String {
        let number = match self.decimal {
            Decimal::Point => return number,
            Decimal::Comma => number.replace('.', ","),
        };
        match self.separator == Separator::Comma && !self.text[..at.start].ends_with('"') {
            true => format!("\"{number}\""),
            false => number,
        }
    }
}

fn numbers<const N: usize>(
    places: &[Range<usize>; N],
    number: impl Fn(&Range<usize>) -> Result<f64, String>,
) -> Result<[f64; N], String> {
    let mut found = [0.0; N];
    for (found, place) in found.iter_mut().zip(places) {
        *found = number(place)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::{Program, ProgramTarget};
    use crate::wire::columns::ColumnsBody;
    use crate::wire::compensate::CompensateAnswer;
    use std::path::Path;

    fn parse(bytes: &[u8], columns: &str) -> anyhow::Result<Program> {
        let columns = ColumnsBody::parse(columns.as_bytes()).unwrap();
        Program::parse(Path::new("program"), bytes, &columns)
    }

    fn q_deg(program: &Program) -> Vec<Vec<f64>> {
        let targets = program.targets().into_iter();
        let targets = targets.map(|target| match target {
            ProgramTarget::Joints(q_deg) => q_deg,
            ProgramTarget::Cartesian(target) => target.q_near_deg,
        });
        let rounded = |q: f64| (q * 1e9).round() / 1e9;
        targets
            .map(|q_deg| q_deg.into_iter().map(rounded).collect())
            .collect()
    }

    fn corrected(program: &Program, q_deg: &[&[f64]]) -> Vec<u8> {
        program.with(&CompensateAnswer {
            q_deg: q_deg.iter().map(|q_deg| q_deg.to_vec()).collect(),
            ..CompensateAnswer::default()
        })
    }

    #[test]
    fn a_table_keeps_its_form() {
        let text = "\u{feff}# made offline\r\nName;J1 [°];J2 [°];X;Y;Z\r\nP1;\"10,5\"; -20,25;1,5;2;3\r\n\r\nP2;1;2;1;2;3";
        let wanted = "\u{feff}# made offline\r\nName;J1 [°];J2 [°];X;Y;Z\r\nP1;\"10,7500000\"; -20,0000000;1,5;2;3\r\n\r\nP2;1,5000000;2,5000000;1;2;3";
        let utf16 =
            |text: &str| -> Vec<u8> { text.encode_utf16().flat_map(u16::to_le_bytes).collect() };
        for (bytes, wanted) in [
            (text.as_bytes().to_vec(), wanted.as_bytes().to_vec()),
            (utf16(text), utf16(wanted)),
        ] {
            let program = parse(&bytes, "{}").unwrap();
            assert_eq!(q_deg(&program), [[10.5, -20.25], [1.0, 2.0]]);
            assert_eq!(program.notes[0], "corrected columns: J1 [°], J2 [°]");
            assert!(program.notes[1].contains("X, Y, Z"), "{:?}", program.notes);
            let found = corrected(&program, &[&[10.75, -20.0], &[1.5, 2.5]]);
            assert_eq!(found, wanted, "{}", String::from_utf8_lossy(&found));
            assert_eq!(program.lines(&[0, 1]), "3, 5");
        }
    }

    #[test]
    fn units_are_stated_as_for_measurements() {
        let text = "J1,J2\n1,2\n";
        let error = parse(text.as_bytes(), "{}").err().unwrap().to_string();
        assert!(error.contains("--joint-unit"), "{error}");
        let program = parse(text.as_bytes(), "{\"joint_unit\": \"rad\"}").unwrap();
        let found = corrected(&program, &[&[90.0, 180.0]]);
        assert_eq!(found, b"J1,J2\n1.570796327,3.141592654\n");
        assert!(parse(b"J1 [deg];J2 [deg]\n1,5;2.5\n", "{}").is_err());
    }

    #[test]
    fn a_comma_in_a_number_is_no_separator() {
        let text = "Name,J1 [deg],J2 [deg]\nP1,\"10,5\",20\n";
        let program = parse(text.as_bytes(), "{}").unwrap();
        let found = corrected(&program, &[&[10.75, 20.5]]);
        let wanted = "Name,J1 [deg],J2 [deg]\nP1,\"10,7500000\",\"20,5000000\"\n";
        assert_eq!(String::from_utf8(found).unwrap(), wanted);
    }

    #[test]
    fn robot_programs_are_refused_with_the_way_round() {
        let kuka = "DEFDAT CAL\nDECL E6AXIS XP2={A1 10,A2 -90,A3 0,A4 0,A5 0,A6 0}\nENDDAT\n";
        for text in [
            kuka,
            "DECL E6POS XP1={X 1.0,Y 2.0,Z 3}\n",
            "/JOB\n///PULSE\n",
        ] {
            let error = parse(text.as_bytes(), "{}").err().unwrap().to_string();
            assert!(error.contains("q1_deg"), "{error}");
        }
    }
}
