//! `kincal robots`: lists and shows robots, and edits them. Each further subcommand has a file of its own.

use super::archive::{self, Action};
use super::files::{parse_json, read_json};
use super::list::{self, RobotArguments};
use super::numbers;
use super::robots_library::{self, LibraryCommand};
use super::runtime::block_on;
use super::subject::RobotArgument;
use super::terminal;
use super::usage::Usage;
use crate::wire::robot::{GravityDirection, JointMapBody, MountingBody, NamedMounting};
use crate::wire::robot_patch::RobotPatchBody;
use clap::ValueEnum;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Standard deviation of the direction of gravity if none is stated, degrees. The named mountings have the same value.
const DEFAULT_GRAVITY_STD_DEG: f64 = 2.0;

/// Robots of a server.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Arguments {
    #[command(subcommand)]
    command: Option<RobotCommand>,
    #[command(flatten)]
    shown: RobotArguments,
}

#[derive(Debug, clap::Subcommand)]
enum RobotCommand {
    /// List robots.
    List(RobotArguments),
    /// Show a robot in full.
    Show(RobotArgument),
    /// Edit a robot; fields that are not given stay as they are.
    Edit(Box<EditArguments>),
    /// Archive a robot: it leaves the lists and takes no uploads, jobs and releases.
    Archive(RobotArgument),
    /// Restore an archived robot.
    Restore(RobotArgument),
    #[command(flatten)]
    Library(LibraryCommand),
}

/// Fields of a robot that can be removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Field {
    SerialNumber,
    Description,
    Mounting,
    JointMap,
}

/// Edit a robot.
#[derive(Debug, clap::Args)]
struct EditArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// Its new name.
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// The maker's serial number.
    #[arg(long, value_name = "TEXT")]
    serial_number: Option<String>,
    /// Free text.
    #[arg(long, value_name = "TEXT")]
    description: Option<String>,
    /// floor, wall, ceiling, or the direction of gravity in the base frame: X,Y,Z or X,Y,Z,STD_DEG.
    #[arg(long, value_name = "MOUNTING", allow_hyphen_values = true)]
    mounting: Option<MountingArgument>,
    /// Limits of each joint in degrees: LOWER:UPPER,… with `none` for a joint without limits.
    #[arg(long, value_name = "LIMITS", allow_hyphen_values = true, value_parser = limits)]
    limits: Option<Limits>,
    /// The controller's joint convention: {"sign": …, "offset_deg": …, "coupling": …}, or a file with it. Refused once a set was released.
    #[arg(long, value_name = "JSON or FILE", conflicts_with_all = ["sign", "offset_deg"])]
    joint_map: Option<PathBuf>,
    /// The controller's joint convention: 1 or -1 for each joint, with commas.
    #[arg(
        long,
        value_name = "SIGNS",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    sign: Option<Vec<f64>>,
    /// The controller's joint convention: the offset that is added to each joint, degrees, with commas.
    #[arg(
        long,
        value_name = "OFFSETS",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    offset_deg: Option<Vec<f64>>,
    /// Remove these fields.
    #[arg(long, value_name = "FIELD", value_enum, value_delimiter = ',')]
    remove: Vec<Field>,
}

/// A mounting on the command line.
#[derive(Clone, Copy, Debug)]
pub struct MountingArgument(pub MountingBody);

impl FromStr for MountingArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let named = match text {
            "floor" => Some(NamedMounting::Floor),
            "wall" => Some(NamedMounting::Wall),
            "ceiling" => Some(NamedMounting::Ceiling),
            _ => None,
        };
        if let Some(named) = named {
            return Ok(Self(MountingBody::Named(named)));
        }
        let (gravity_in_base, std_deg) = match numbers::all(text).as_deref() {
            Some([x, y, z]) => ([*x, *y, *z], DEFAULT_GRAVITY_STD_DEG),
            Some([x, y, z, std_deg]) => ([*x, *y, *z], *std_deg),
            _ => {
                return Err(
                    "floor, wall, ceiling, or the direction in which things fall: X,Y,Z or X,Y,Z,STD_DEG"
                        .into(),
                );
            }
        };
        Ok(Self(MountingBody::Direction(GravityDirection {
            gravity_in_base,
            std_deg,
        })))
    }
}

/// Limits of all joints.
type Limits = Vec<Option<[f64; 2]>>;

fn limits(text: &str) -> Result<Limits, String> {
    let range = |text: &str| {
        let (lower, upper) = text.split_once(':')?;
        let number = |text: &str| text.trim().parse::<f64>().ok();
        Some([number(lower)?, number(upper)?])
    };
    let one = |text: &str| match text.trim() {
        "none" => Some(None),
        text => range(text).map(Some),
    };
    let all: Option<Limits> = text.split(',').map(one).collect();
    all.ok_or_else(|| {
        "give LOWER:UPPER or none for each joint, such as -170:170,none,-90:90".into()
    })
}

/// `kincal robots`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        None => {
            refuse_name_of_command(arguments.shown.id.as_deref())?;
            list::robots(&arguments.shown)
        }
        Some(RobotCommand::List(list)) => list::robots(list),
        Some(RobotCommand::Show(one)) => terminal::json(&one.get("")?),
        Some(RobotCommand::Edit(changes)) => edit(changes),
        Some(RobotCommand::Archive(one)) => set_archived(one, Action::Archive),
        Some(RobotCommand::Restore(one)) => set_archived(one, Action::Restore),
        Some(RobotCommand::Library(command)) => robots_library::run(command),
    }
}

/// Refuses the name of a subcommand after options. Without this, `kincal robots --server URL list` would look for a robot with the id
/// `list`.
fn refuse_name_of_command(id: Option<&str>) -> anyhow::Result<()> {
    let known = [
        "list", "show", "edit", "archive", "restore", "find", "add", "posture",
    ];
    match id.filter(|id| known.contains(id)) {
        Some(id) => {
            let text = format!("write the options after {id}: kincal robots {id} --server URL …");
            Err(Usage(text).into())
        }
        None => Ok(()),
    }
}

fn set_archived(of: &RobotArgument, action: Action) -> anyhow::Result<()> {
    block_on(async {
        let (client, path) = of.at("").await?;
        archive::one(&client, &path, action, &of.output).await
    })
}

fn edit(arguments: &EditArguments) -> anyhow::Result<()> {
    let patch = patch(arguments)?;
    if patch == RobotPatchBody::default() {
        return Err(Usage(
            "nothing to edit: give --name, --serial-number, --description, --mounting, --limits, --joint-map, --sign, --offset-deg or --remove"
                .into(),
        )
        .into());
    }
    let robot = arguments.robot.send(reqwest::Method::PATCH, "", &patch)?;
    if let Some(name) = &arguments.name {
        arguments.robot.server.warn_of_duplicate_name(name);
    }
    arguments.robot.output.print(&robot, || {
        format!(
            "{} is edited; results that were computed before keep the robot as it was",
            robot["id"].as_str().unwrap_or_default()
        )
    })
}

/// A joint map as an option: its JSON, or a file with it.
pub fn joint_map(text: &Path) -> anyhow::Result<JointMapBody> {
    match text.as_os_str().as_encoded_bytes() {
        json @ [b'{', ..] => parse_json(Path::new("--joint-map"), json, "a joint map"),
        _ => read_json(text, "a joint map"),
    }
}

fn patch(arguments: &EditArguments) -> anyhow::Result<RobotPatchBody> {
    let removed =
        |field| -> Option<Option<String>> { arguments.remove.contains(&field).then_some(None) };
    let given = |text: &Option<String>| text.clone().map(Some);
    let of_joints = match (&arguments.joint_map, &arguments.sign, &arguments.offset_deg) {
        (Some(text), ..) => Some(joint_map(text)?),
        (None, None, None) => None,
        (None, sign, offset_deg) => Some(JointMapBody {
            sign: sign.clone(),
            offset_deg: offset_deg.clone(),
            coupling: None,
        }),
    };
    Ok(RobotPatchBody {
        name: arguments.name.clone(),
        serial_number: given(&arguments.serial_number).or(removed(Field::SerialNumber)),
        description: given(&arguments.description).or(removed(Field::Description)),
        mounting: arguments
            .mounting
            .map(|mounted| Some(mounted.0))
            .or(arguments.remove.contains(&Field::Mounting).then_some(None)),
        joint_limits_deg: arguments.limits.clone(),
        joint_map: of_joints
            .map(Some)
            .or(arguments.remove.contains(&Field::JointMap).then_some(None)),
    })
}
