//! `kincal compensate`: corrects the joint targets of a program.

use super::client::ServerArguments;
use super::column_options::ColumnOptions;
use super::files::{cannot_be_used, convention, read, read_json};
use super::numbers::three_mm;
use super::program;
use super::subject::post_to_parameter_set;
use super::terminal;
use super::terminal::{Output, plain};
use super::usage::Usage;
use crate::measurement::RotationConvention;
use crate::operations::program::ProgramTarget;
use crate::operations::{self, Correctable};
use crate::wire::compensate::{
    Base, CompensateAnswer, CompensateBody, ErrorFrame, LeftOut, MAX_TARGETS_PER_REQUEST, Mode,
    Status,
};
use crate::wire::export::ExportDocument;
use crate::wire::issue::Invalid;
use crate::wire::robot::Robot;
use crate::wire::tool::ToolBody;
use anyhow::Context;
use std::path::PathBuf;

/// Correct the targets of a program that was made offline.
///
/// PROGRAM is a table with joint targets in q1_deg … qn_deg (or q1_rad …, J1 [deg] …), or with Cartesian targets and joint values near them: x_mm y_mm
/// z_mm with quat_w quat_x quat_y quat_z, or with rx_deg ry_deg rz_deg and --rotation. Of commanded and measured joint values, the commanded ones are
/// targets. The output is the program with corrected targets; everything else stays as it is. With --json, the output also has the status of each
/// target.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// With --parameters: PROGRAM. Without: PARAMETERS.json (GET /v1/parameter-sets/{id}/export) and PROGRAM.
    #[arg(value_name = "PARAMETERS.json PROGRAM", num_args = 1..=2, required = true)]
    files: Vec<PathBuf>,
    /// A parameter set on the server instead of a file: its id, or its robot for the released set.
    #[arg(long, env = "KINCAL_PARAMETERS", value_name = "ID|ROBOT")]
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
    /// Reflector that is used as the tool (0-based) [default: 0, or the tool of --tool-mm].
    #[arg(long, env = "KINCAL_TARGET")]
    target: Option<usize>,
    /// Name of a tool that the robot has on the server.
    #[arg(long = "tool", env = "KINCAL_TOOL", value_name = "NAME", conflicts_with_all = ["tool_mm", "target"])]
    tool_name: Option<String>,
    /// The frame of Cartesian targets: base, measuring, or the name of a work frame that the robot has on the server [default: base].
    #[arg(long, env = "KINCAL_FRAME_OF_TARGETS", value_name = "FRAME")]
    frame: Option<String>,
    /// The tool centre point in the flange frame: X,Y,Z in mm.
    #[arg(long, env = "KINCAL_TOOL_MM", value_name = "X,Y,Z", value_parser = three_mm, allow_hyphen_values = true)]
    tool_mm: Option<[f64; 3]>,
    /// What rx_deg, ry_deg and rz_deg of Cartesian targets mean: extrinsic_xyz (FANUC W P R), intrinsic_zyx (KUKA A B C), …, or rotation_vector.
    #[arg(long, env = "KINCAL_ROTATION", value_name = "CONVENTION", value_parser = convention)]
    rotation: Option<RotationConvention>,
    #[command(flatten)]
    columns: ColumnOptions,
    #[command(flatten)]
    output: Output,
}

/// Prints the program with corrected joint values on standard output; everything else stays as it is.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(path) = arguments.files.last() else {
        return Err(Usage("PROGRAM is missing".into()).into());
    };
    if arguments.target.is_some() && arguments.tool_mm.is_some() {
        return Err(Usage("the tool is either a reflector or a tool centre point: give --target or --tool-mm, not both".into()).into());
    }
    let columns = arguments.columns.body()?;
    let program = program::parse(path, &read(path)?, &columns, arguments.rotation)?;
    let targets = program.targets();
    let part = |(i, part): (usize, &[_])| {
        correct(arguments, part).map_err(|error| {
            program::with_file_rows(&program, error, path, i * MAX_TARGETS_PER_REQUEST)
        })
    };
    let mut parts = targets
        .chunks(MAX_TARGETS_PER_REQUEST)
        .enumerate()
        .map(part);
    let mut answer = parts.next().unwrap_or_else(|| correct(arguments, &[]))?;
    for part in parts {
        answer.extend(part?);
    }
    program::notes(&program)
        .iter()
        .for_each(|note| eprintln!("{}", plain(note)));
    eprintln!(
        "warning (taught_targets): targets that were taught by moving the robot there already hold its errors: correct only those that were programmed offline"
    );
    eprintln!(
        "targets are met in {}",
        match answer.frame {
            ErrorFrame::Measuring =>
                "the measuring frame, which is the nominal base frame: rotation and shift of the base are corrected",
            ErrorFrame::RobotBase => "the robot's own base frame, wherever it stands",
        }
    );
    if let Some(warning) = left_out_in_words(&answer.left_out) {
        eprintln!("warning (base_and_tool): {warning}");
    }
    for warning in &answer.warnings {
        let lines = match warning.rows.is_empty() {
            true => String::new(),
            false => format!(" (lines {})", program::lines(&program, &warning.rows)),
        };
        eprintln!("warning ({}): {}{lines}", warning.code, warning.detail);
    }
    match arguments.output.json {
        true => terminal::json(&answer)?,
        false => terminal::raw(program.with(&answer)),
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
        let found: Vec<usize> = (0..statuses.len())
            .filter(|target| statuses[*target] == status)
            .collect();
        if !found.is_empty() {
            eprintln!(
                "warning: {} of {} targets are {what} (lines {})",
                found.len(),
                statuses.len(),
                program::lines(&program, &found)
            );
        }
    }
    Ok(())
}

/// Smallest rotation in the warning, degrees: smaller ones are below measurement accuracy.
const NOTICED_DEG: f64 = 0.001;
/// Smallest shift in the warning, mm.
const NOTICED_MM: f64 = 0.01;

/// Warning about the parts of the base and the flange that are not corrected; `None` if they are negligible.
fn left_out_in_words(left_out: &LeftOut) -> Option<String> {
    let is_noticed = left_out.base_turn_deg.max(left_out.flange_turn_deg) > NOTICED_DEG
        || left_out.base_shift_mm.max(left_out.flange_shift_mm) > NOTICED_MM;
    is_noticed.then(|| {
        format!(
            "not corrected: the base frame is turned by {:.4}° and shifted by {:.3} mm from the nominal one (link 1, mastering of joint 1), the \
             flange by {:.4}° and {:.3} mm (last joint): measure the work object and the tool with this robot, or add these values to them",
            left_out.base_turn_deg,
            left_out.base_shift_mm,
            left_out.flange_turn_deg,
            left_out.flange_shift_mm
        )
    })
}

fn correct(arguments: &Arguments, targets: &[ProgramTarget]) -> anyhow::Result<CompensateAnswer> {
    let mut body = CompensateBody {
        frame: arguments.frame.clone(),
        target: arguments.target,
        tool: arguments.tool_mm.map(|translation_mm| ToolBody {
            translation_mm,
            ..ToolBody::default()
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
        (Some(id), [_]) => {
            let answer = post_to_parameter_set(&arguments.server, id, "/compensate", &body)?;
            serde_json::from_value(answer)
                .context("the server's answer is of another version of kincal")
        }
        (None, [parameters, _]) => {
            let document: ExportDocument = read_json(
                parameters,
                "a file of parameters: kincal export ID, or kincal calibrate … --parameters-file FILE",
            )?;
            let unusable = |invalid: Invalid| Usage(cannot_be_used(parameters, &invalid.issues));
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
        (Some(_), _) => Err(Usage("with --parameters only PROGRAM is given".into()).into()),
        (None, _) => Err(Usage(
            "give PARAMETERS.json and PROGRAM, or --parameters ID and PROGRAM".into(),
        )
        .into()),
    }
}
