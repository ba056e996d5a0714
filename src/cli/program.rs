//! A program as a CSV file of joint or Cartesian targets: reads it, and writes it again with corrected targets.

use super::failure::Refused;
use super::files;
use super::usage::Usage;
use crate::measurement::column_names::{Known, Unit, recognise};
use crate::wire::compensate::{CartesianTarget, CompensateAnswer};
use crate::wire::issue::{Invalid, Issue};
use std::path::Path;

/// Columns of a Cartesian target.
const POSITION: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
const QUATERNION: [&str; 4] = ["quat_w", "quat_x", "quat_y", "quat_z"];

/// A program: its header, its rows, and the columns of its targets.
pub struct Program {
    bytes: Vec<u8>,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Column of each joint, and whether it is in radians.
    joints: Vec<(usize, bool)>,
    /// Columns of the position, mm, where targets are Cartesian.
    position: Option<[usize; 3]>,
    /// Columns of the quaternion, if the program has them.
    quaternion: Option<[usize; 4]>,
    separator: u8,
    /// Whether its numbers have decimal commas.
    has_commas: bool,
}

/// A target of a program.
#[derive(Clone)]
pub enum ProgramTarget {
    Joints(Vec<f64>),
    Cartesian(CartesianTarget),
}

impl Program {
    pub fn parse(bytes: Vec<u8>) -> Result<Self, String> {
        let first = bytes
            .split(|byte| *byte == b'\n')
            .next()
            .unwrap_or_default();
        let separator = match (first.contains(&b';'), first.contains(&b'\t')) {
            (true, _) => b';',
            (false, true) => b'\t',
            _ => b',',
        };
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .delimiter(separator)
            .from_reader(bytes.as_slice());
        let mut records = reader.records();
        let cells =
            |record: csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
        let header = records
            .next()
            .ok_or("the file is empty")?
            .map(cells)
            .map_err(|e| e.to_string())?;
        let rows = records
            .map(|record| record.map(cells))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| e.to_string())?;
        let known: Vec<Known> = header
            .iter()
            .map(|name| recognise(name.trim_start_matches('\u{feff}'), None))
            .collect();
        let place = |joint: usize| {
            let named = |unit: &'static str| {
                let meant = Known::Joint(joint, Unit::Is(unit));
                known.iter().position(|known| *known == meant)
            };
            named("deg")
                .map(|column| (column, false))
                .or_else(|| named("rad").map(|column| (column, true)))
        };
        let joints: Vec<(usize, bool)> = (1..).map_while(place).collect();
        if joints.is_empty() {
            return Err("it has no column q1_deg or q1_rad: joint values are in columns q1_deg … qn_deg, or q1_rad … qn_rad, or J1 [deg] …; the unit is part \
                        of the name".into());
        }
        let named = |name: &str| {
            let is_named = |h: &String| h.trim().trim_start_matches('\u{feff}') == name;
            header.iter().position(is_named)
        };
        let position = POSITION.map(named);
        let quaternion = QUATERNION.map(named);
        let has_comma =
            |row: &Vec<String>| joints.iter().any(|(column, _)| row[*column].contains(','));
        Ok(Self {
            has_commas: separator != b',' && rows.iter().any(has_comma),
            separator,
            position: all_there(position),
            quaternion: all_there(quaternion),
            bytes,
            header,
            rows,
            joints,
        })
    }

    pub fn targets(&self) -> Result<Vec<ProgramTarget>, String> {
        let number =
            |row: usize, column: usize| self.number((row, &self.rows[row]), (column, false));
        let target = |(row, q_deg): (usize, Vec<f64>)| {
            let Some([x, y, z]) = self.position else {
                return Ok(ProgramTarget::Joints(q_deg));
            };
            let quaternion = match self.quaternion {
                None => None,
                Some([w, x, y, z]) => Some([
                    number(row, w)?,
                    number(row, x)?,
                    number(row, y)?,
                    number(row, z)?,
                ]),
            };
            Ok(ProgramTarget::Cartesian(CartesianTarget {
                position_mm: [number(row, x)?, number(row, y)?, number(row, z)?],
                quaternion,
                rotation: None,
                q_near_deg: q_deg,
            }))
        };
        self.q_deg()?.into_iter().enumerate().map(target).collect()
    }

    /// The number in a cell. Radians are converted to degrees.
    fn number(
        &self,
        (row, cells): (usize, &Vec<String>),
        (column, is_rad): (usize, bool),
    ) -> Result<f64, String> {
        let text = cells[column].trim();
        let pointed = match self.has_commas && !text.contains('.') {
            true => text.replace(',', "."),
            false if self.has_commas => String::new(),
            false => text.to_owned(),
        };
        let number = pointed
            .parse::<f64>()
            .ok()
            .filter(|number| number.is_finite());
        let place = || {
            let row = files::row(row, Some(&self.bytes));
            format!("{row}, column {}", self.header[column])
        };
        let number = number.ok_or_else(|| format!("{}: {text:?} is not a number", place()))?;
        Ok(if is_rad { number.to_degrees() } else { number })
    }

    fn q_deg(&self) -> Result<Vec<Vec<f64>>, String> {
        let row = |row: (usize, &Vec<String>)| {
            let joints = self.joints.iter();
            joints.map(|joint| self.number(row, *joint)).collect()
        };
        self.rows.iter().enumerate().map(row).collect()
    }

    /// Rewrites an error in terms of the program's rows and columns, and of options. `first` is the first row of the request.
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
        let mut pointer = issue
            .pointer
            .as_deref()
            .unwrap_or_default()
            .split('/')
            .skip(1);
        let (field, row, joint) = (pointer.next(), pointer.next(), pointer.next());
        let column = joint
            .and_then(|joint| joint.parse::<usize>().ok())
            .and_then(|joint| self.joints.get(joint));
        match (field, row.and_then(|row| row.parse::<usize>().ok()), column) {
            (Some("q_deg"), Some(row), Some((column, _))) => {
                format!(
                    "{}, column {}: {detail}",
                    files::row(first + row, Some(&self.bytes)),
                    self.header[*column]
                )
            }
            (Some("targets"), Some(row), _) => {
                let row = files::row(first + row, Some(&self.bytes));
                format!("{row}: {detail}")
            }
            (Some("frame"), ..) => format!("--frame: {detail}"),
            (Some("tool_name"), ..) => format!("--tool: {detail}"),
            (Some("q_deg"), ..) => format!("its columns are q1 … q{}: {detail}", self.joints.len()),
            (Some("mode"), ..) => format!("--mode: {detail}"),
            (Some("base"), ..) => format!("--base: {detail}"),
            (Some("target"), ..) => format!("--target: {detail}"),
            (Some("tool"), ..) => format!("--tool-mm: {detail}"),
            _ => files::fault(issue, None),
        }
    }

    /// The program with corrected targets.
    pub fn with(&self, answer: &CompensateAnswer) -> anyhow::Result<String> {
        let mut writer = csv::WriterBuilder::new()
            .delimiter(self.separator)
            .from_writer(Vec::new());
        writer.write_record(&self.header)?;
        for (i, (row, q_deg)) in self.rows.iter().zip(&answer.q_deg).enumerate() {
            let mut row = row.clone();
            let mut put = |column: usize, number: String| {
                row[column] = match self.has_commas {
                    true => number.replace('.', ","),
                    false => number,
                };
            };
            for ((column, is_rad), q) in self.joints.iter().zip(q_deg) {
                let number = match is_rad {
                    true => format!("{:.9}", q.to_radians()),
                    false => format!("{q:.7}"),
                };
                put(*column, number);
            }
            if let Some(pose) = answer.poses.as_ref().and_then(|poses| poses.get(i)) {
                let position = self.position.iter().flatten().zip(pose.position_mm);
                position.for_each(|(column, mm)| put(*column, format!("{mm:.5}")));
                let quaternion = self.quaternion.iter().flatten().zip(pose.quaternion);
                quaternion.for_each(|(column, q)| put(*column, format!("{q:.9}")));
            }
            writer.write_record(&row)?;
        }
        Ok(String::from_utf8(writer.into_inner()?)?)
    }
}

/// `Some` if all columns exist.
fn all_there<const N: usize>(columns: [Option<usize>; N]) -> Option<[usize; N]> {
    let all: Option<Vec<usize>> = columns.into_iter().collect();
    all?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::Program;
    use crate::wire::compensate::{CompensateAnswer, ErrorFrame};

    #[test]
    fn a_program_keeps_its_form() {
        let text = "Name;J1 [°];J2 [°]\nP1;10,5;-20,25\nP2;1;2\n";
        let program = Program::parse(text.into()).unwrap();
        assert_eq!(program.q_deg().unwrap(), [[10.5, -20.25], [1.0, 2.0]]);
        let mut answer = CompensateAnswer::with_capacity(2, ErrorFrame::RobotBase);
        answer.q_deg = vec![vec![10.75, -20.0], vec![1.5, 2.5]];
        let corrected = program.with(&answer).unwrap();
        assert_eq!(
            corrected,
            "Name;J1 [°];J2 [°]\nP1;10,7500000;-20,0000000\nP2;1,5000000;2,5000000\n"
        );
        let mixed = Program::parse("J1 [deg];J2 [deg]\n1,5;2.5\n".into()).unwrap();
        assert!(mixed.q_deg().is_err());
        assert!(Program::parse("J1;J2\n1;2\n".into()).is_err());
    }
}
