//! `kincal compensate`: corrects the joint targets of a program.

use super::client::ServerArguments;
use super::failure::Refused;
use super::files::{self, cannot_be_used, read, read_json};
use super::runtime::block_on;
use super::terminal;
use super::terminal::Output;
use super::usage::Usage;
use crate::measurement::column_names::{Known, Unit, recognise};
use crate::operations::{self, Correctable};
use crate::wire::compensate::{
    Base, CartesianTarget, CompensateAnswer, CompensateBody, ErrorFrame, LeftOut,
    MAX_TARGETS_PER_REQUEST, Mode, Status,
};
use crate::wire::export::ExportDocument;
use crate::wire::issue::{Invalid, Issue};
use crate::wire::robot::Robot;
use crate::wire::tool::ToolBody;
use anyhow::Context;
use std::path::{Path, PathBuf};

/// Correct the targets of a program that was made offline.
///
/// PROGRAM.csv has joint targets in q1_deg … qn_deg (or q1_rad …), or Cartesian targets in x_mm y_mm z_mm quat_w quat_x quat_y quat_z with joint
/// values near them. Both come back corrected, all other columns as they are. The JSON has also the status of each target.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// With --parameters: PROGRAM.csv. Without: PARAMETERS.json (GET /v1/parameter-sets/{id}/export) and PROGRAM.csv.
    #[arg(value_name = "PARAMETERS.json PROGRAM.csv", num_args = 1..=2, required = true)]
    files: Vec<PathBuf>,
    /// Id of a parameter set on the server, instead of a file.
    #[arg(long, env = "KINCAL_PARAMETERS", value_name = "ID")]
    parameters: Option<String>,
    #[command(flatten)]
    server: ServerArguments,
    /// Correct the tool's pose, or only its position.
    #[arg(long, env = "KINCAL_MODE", value_enum, default_value_t = Mode::Pose)]
    mode: Mode,
    /// Frame in which the targets are reached: the measuring frame, which corrects the base error too, or the robot's own base frame
    /// [default: measured if positions were measured in the base frame, else robot].
    #[arg(long, env = "KINCAL_BASE", value_enum)]
    base: Option<Base>,
    /// The reflector that is the tool (0-based) [default: 0, or the tool of --tool-mm].
    #[arg(long, env = "KINCAL_TARGET")]
    target: Option<usize>,
    /// A tool that the robot has on the server, by its name.
    #[arg(long = "tool", env = "KINCAL_TOOL", value_name = "NAME", conflicts_with_all = ["tool_mm", "target"])]
    tool_name: Option<String>,
    /// The frame of Cartesian targets: base, measuring, or the name of a work frame that the robot has on the server [default: base].
    #[arg(long, env = "KINCAL_FRAME_OF_TARGETS", value_name = "FRAME")]
    frame: Option<String>,
    /// The tool centre point in the flange frame: X,Y,Z in mm.
    #[arg(long, env = "KINCAL_TOOL_MM", value_name = "X,Y,Z", value_parser = tool_mm, allow_hyphen_values = true)]
    tool_mm: Option<[f64; 3]>,
    #[command(flatten)]
    output: Output,
}

/// Parses three lengths with commas between them.
pub fn tool_mm(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text
        .split(',')
        .map(|number| number.trim().parse::<f64>())
        .collect();
    let three = numbers
        .ok()
        .and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    three
        .filter(|three| three.iter().all(|mm| mm.is_finite()))
        .ok_or_else(|| "three numbers in mm are needed, such as 30,-45,160".into())
}

/// Columns of a Cartesian target.
const POSITION: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
const QUATERNION: [&str; 4] = ["quat_w", "quat_x", "quat_y", "quat_z"];

/// A program: its header, its rows, and the columns of its targets.
struct Program {
    bytes: Vec<u8>,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Column of each joint, and whether it is in radians.
    joints: Vec<(usize, bool)>,
    /// Columns of the position, mm, where targets are Cartesian.
    position: Option<[usize; 3]>,
    /// Columns of the quaternion, if there are some.
    quaternion: Option<[usize; 4]>,
    separator: u8,
    /// Whether its numbers have decimal commas.
    has_commas: bool,
}

/// Prints the program with corrected joint values on standard output; every other column stays as it is.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(path) = arguments.files.last() else {
        return Err(Usage("PROGRAM.csv is missing".into()).into());
    };
    if arguments.target.is_some() && arguments.tool_mm.is_some() {
        return Err(Usage("the tool is either a reflector or a tool centre point: give --target or --tool-mm, not both".into()).into());
    }
    let program = Program::parse(read(path)?)
        .map_err(|error| Usage(format!("{}: {error}", path.display())))?;
    eprintln!(
        "warning (taught_targets): targets that were taught by moving the robot there already hold its errors: correct only those that were programmed offline"
    );
    let targets = program
        .targets()
        .map_err(|error| Usage(format!("{}: {error}", path.display())))?;
    let part = |(i, part): (usize, &[_])| {
        correct(arguments, part)
            .map_err(|error| program.with_file_rows(error, path, i * MAX_TARGETS_PER_REQUEST))
    };
    let mut parts = targets
        .chunks(MAX_TARGETS_PER_REQUEST)
        .enumerate()
        .map(part);
    let mut answer = parts.next().unwrap_or_else(|| correct(arguments, &[]))?;
    for part in parts {
        answer.extend(part?);
    }
    eprintln!(
        "targets are met in {}",
        match answer.frame {
            ErrorFrame::Measuring =>
                "the measuring frame, which is the nominal base frame: what turned or shifted the base is corrected",
            ErrorFrame::RobotBase => "the robot's own base frame, wherever it stands",
        }
    );
    if let Some(warning) = left_out_in_words(&answer.left_out) {
        eprintln!("warning (base_and_tool): {warning}");
    }
    for warning in &answer.warnings {
        eprintln!("warning ({}): {}", warning.code, warning.detail);
    }
    if arguments.output.json {
        say!("{}", serde_json::to_string_pretty(&answer)?);
    } else {
        terminal::raw(program.with(&answer)?);
    }
    let statuses = &answer.status;
    for (status, what) in [
        (
            Status::NearSingular,
            "near a singularity: the closest without a large motion of the joints",
        ),
        (
            Status::JointLimit,
            "at a joint limit: as near as the other joints get",
        ),
        (Status::NotReached, "out of reach"),
    ] {
        let rows: Vec<String> = statuses
            .iter()
            .enumerate()
            .filter(|(_, s)| **s == status)
            .map(|(row, _)| row.to_string())
            .collect();
        if !rows.is_empty() {
            let (n, rows) = (rows.len(), rows.join(", "));
            eprintln!(
                "warning: {n} of {} targets are {what} (rows {rows}; 0 is the first below the header)",
                statuses.len()
            );
        }
    }
    Ok(())
}

/// Smallest rotation, degrees, that is mentioned: smaller ones are below measurement accuracy.
const NOTICED_DEG: f64 = 0.001;
/// Smallest shift that is mentioned, mm.
const NOTICED_MM: f64 = 0.01;

/// What is not corrected, in words; `None` if it is negligible.
fn left_out_in_words(left_out: &LeftOut) -> Option<String> {
    let is_noticed = left_out.base_turn_deg.max(left_out.flange_turn_deg) > NOTICED_DEG
        || left_out.base_shift_mm.max(left_out.flange_shift_mm) > NOTICED_MM;
    is_noticed.then(|| {
        format!(
            "not corrected: the base frame is turned by {:.4}° and shifted by {:.3} mm from the nominal one (link 1, mastering of joint 1), the \
             flange by {:.4}° and {:.3} mm (last joint): measure the work object and the tool with this robot, or take it into them",
            left_out.base_turn_deg,
            left_out.base_shift_mm,
            left_out.flange_turn_deg,
            left_out.flange_shift_mm
        )
    })
}

/// A target of a program.
#[derive(Clone)]
enum ProgramTarget {
    Joints(Vec<f64>),
    Cartesian(CartesianTarget),
}

fn correct(arguments: &Arguments, targets: &[ProgramTarget]) -> anyhow::Result<CompensateAnswer> {
    let mut body = CompensateBody {
        frame: arguments.frame.clone(),
        target: arguments.target,
        tool: arguments.tool_mm.map(|translation_mm| ToolBody {
            translation_mm,
            quaternion: None,
            rotation: None,
        }),
        tool_name: arguments.tool_name.clone(),
        mode: arguments.mode,
        base: arguments.base,
        ..CompensateBody::default()
    };
    for target in targets {
        match target {
            ProgramTarget::Joints(q_deg) => body.q_deg.push(q_deg.clone()),
            ProgramTarget::Cartesian(target) => body.targets.push(target.clone()),
        }
    }
    match (&arguments.parameters, arguments.files.as_slice()) {
        (Some(id), [_]) => block_on(async {
            let path = format!("/v1/parameter-sets/{id}/compensate");
            let answer = arguments
                .server
                .client()?
                .post_json(&path, &serde_json::to_value(&body)?)
                .await?;
            serde_json::from_value(answer)
                .context("the server's answer is of another version of kincal")
        }),
        (None, [parameters, _]) => {
            let document: ExportDocument = read_json(
                parameters,
                "exported parameters, as GET /v1/parameter-sets/ID/export writes it",
            )?;
            let unusable =
                |invalid: Invalid| Usage(cannot_be_used(parameters, &[], &invalid.issues));
            let robot = Robot::try_from(&document.robot).map_err(unusable)?;
            document
                .content
                .check(robot.links.len())
                .map_err(unusable)?;
            if arguments.tool_name.is_some() {
                let why = "--tool is a tool on a server: give --parameters ID, or --tool-mm X,Y,Z";
                return Err(Usage(why.into()).into());
            }
            let from = Correctable {
                robot: &robot,
                content: &document.content,
                provenance: &document.provenance,
                estimate: None,
                measurement_set_id: None,
                work_frame: None,
                named_tool: None,
            };
            Ok(operations::compensate(&body, from)?)
        }
        (Some(_), _) => Err(Usage("with --parameters only PROGRAM.csv is given".into()).into()),
        (None, _) => Err(Usage(
            "give PARAMETERS.json and PROGRAM.csv, or --parameters ID and PROGRAM.csv".into(),
        )
        .into()),
    }
}

impl Program {
    fn parse(bytes: Vec<u8>) -> Result<Self, String> {
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

    fn targets(&self) -> Result<Vec<ProgramTarget>, String> {
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

    /// The number in a cell; of angles in radians in degrees.
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
    fn with_file_rows(&self, error: anyhow::Error, path: &Path, first: usize) -> anyhow::Error {
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
    fn with(&self, answer: &CompensateAnswer) -> anyhow::Result<String> {
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

/// All columns, or none.
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
