//! `kincal robots find|add|posture`: ready arms, robots from descriptions, and the comparison of a posture with the pendant.

use super::client::{Client, ServerArguments};
use super::files::{cannot_be_used, parse_json, read};
use super::import::{format_of, print_notes};
use super::numbers::{self, three_angles, three_mm};
use super::runtime::block_on;
use super::terminal::{Output, columns, plain};
use super::usage::Usage;
use crate::operations::import::import_with;
use crate::operations::{MAX_APART, posture, robot_models};
use crate::wire::decimals::fixed;
use crate::wire::import::{ImportDigits, ImportFormat};
use crate::wire::posture::{PostureAnswer, PostureBody, ShownOrientation};
use crate::wire::robot::{LinkBody, MountingBody, NamedMounting, Robot, RobotBody};
use crate::wire::robot_model::RobotModel;
use crate::wire::tool::ToolBody;
use reqwest::Method;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Commands about ready arms and new robots.
#[derive(Debug, clap::Subcommand)]
pub enum LibraryCommand {
    /// Find a ready arm by maker and name; no server is needed. If a single arm is found, it is shown in full.
    Find(FindArguments),
    /// Add a robot to the server: a ready arm, a URDF, a table of Denavit-Hartenberg parameters, or a robot file.
    Add(AddArguments),
    /// The nominal pose of the flange at the pendant's joint values, to compare with the pendant.
    #[command(allow_negative_numbers = true)]
    Posture(Box<PostureArguments>),
}

/// Find a ready arm.
#[derive(Debug, clap::Args)]
pub struct FindArguments {
    /// Words of maker and name, or an id. Case, blanks and punctuation are ignored.
    #[arg(value_name = "TEXT")]
    text: Vec<String>,
    /// Only arms of this maker.
    #[arg(long, env = "KINCAL_MAKER")]
    maker: Option<String>,
    /// Write the robot file of the one arm that is found.
    #[arg(long, env = "KINCAL_ROBOT_FILE", value_name = "FILE.json")]
    robot_file: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

/// Add a robot.
#[derive(Debug, clap::Args)]
pub struct AddArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// A URDF (xacro expanded), a table (CSV or JSON; give --convention), or a robot file.
    #[arg(value_name = "FILE", required_unless_present = "arm")]
    file: Option<PathBuf>,
    /// A ready arm: its id or name, as `kincal robots find` lists it.
    #[arg(long, env = "KINCAL_ARM", value_name = "ARM", conflicts_with = "file")]
    arm: Option<String>,
    /// Convention of a table: dh (distal, standard) or mdh (Craig, modified).
    #[arg(long, env = "KINCAL_CONVENTION", value_enum)]
    convention: Option<ImportFormat>,
    /// The link at the end of the robot, in a URDF with several.
    #[arg(long, env = "KINCAL_TIP", value_name = "LINK")]
    tip: Option<String>,
    /// Digits of a URDF's numbers: `source` replaces angles that are a rounded multiple of 90° by the exact multiple.
    #[arg(long, env = "KINCAL_DIGITS", value_enum, default_value = "source")]
    digits: ImportDigits,
    /// The robot's name [default: the arm's, the file's].
    #[arg(long, env = "KINCAL_NAME")]
    name: Option<String>,
    /// The maker's serial number.
    #[arg(long, env = "KINCAL_SERIAL_NUMBER", value_name = "TEXT")]
    serial_number: Option<String>,
    /// How the robot is mounted.
    #[arg(long, env = "KINCAL_MOUNTING", value_parser = mounting)]
    mounting: Option<NamedMounting>,
    #[command(flatten)]
    output: Output,
}

/// Check a posture.
#[derive(Debug, clap::Args)]
pub struct PostureArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The pendant's joint values, degrees, with spaces or commas between them.
    #[arg(value_name = "DEGREES", required = true, value_parser = degrees)]
    q_deg: Vec<Degrees>,
    /// The robot on the server: its id, name or serial number.
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT", required_unless_present_any = ["arm", "robot_file"])]
    robot: Option<String>,
    /// A ready arm, without a server.
    #[arg(long, env = "KINCAL_ARM", value_name = "ARM")]
    arm: Option<String>,
    /// A robot file, without a server.
    #[arg(
        long,
        env = "KINCAL_ROBOT_FILE",
        value_name = "ROBOT.json",
        conflicts_with = "arm"
    )]
    robot_file: Option<PathBuf>,
    /// Position of the active tool in the flange frame: X,Y,Z in mm [default: the flange].
    #[arg(long, env = "KINCAL_TOOL_MM", value_name = "X,Y,Z", value_parser = three_mm, allow_hyphen_values = true)]
    tool_mm: Option<[f64; 3]>,
    /// Position that the pendant shows: X,Y,Z in mm. The output states its distance from the model's position.
    #[arg(long, env = "KINCAL_SHOWN_MM", value_name = "X,Y,Z", value_parser = three_mm, allow_hyphen_values = true)]
    shown_mm: Option<[f64; 3]>,
    #[command(flatten)]
    shown_orientation: ShownOrientationArguments,
    #[command(flatten)]
    output: Output,
}

/// The orientation that the pendant shows, in the convention of its maker.
#[derive(Debug, clap::Args)]
#[group(multiple = false)]
struct ShownOrientationArguments {
    /// A,B,C that a KUKA pendant shows, degrees. The output states the angle from the model's orientation; this checks the last joint, too.
    #[arg(long, env = "KINCAL_SHOWN_ABC_DEG", value_name = "A,B,C", value_parser = three_angles, allow_hyphen_values = true)]
    shown_abc_deg: Option<[f64; 3]>,
    /// W,P,R that a FANUC pendant shows, or Rx,Ry,Rz of Yaskawa, degrees.
    #[arg(long, env = "KINCAL_SHOWN_WPR_DEG", value_name = "W,P,R", value_parser = three_angles, allow_hyphen_values = true)]
    shown_wpr_deg: Option<[f64; 3]>,
    /// Rotation vector RX,RY,RZ that a pendant of Universal Robots shows, rad.
    #[arg(long, env = "KINCAL_SHOWN_ROTATION_VECTOR_RAD", value_name = "RX,RY,RZ", value_parser = three_angles, allow_hyphen_values = true)]
    shown_rotation_vector_rad: Option<[f64; 3]>,
    /// Quaternion q1,q2,q3,q4 that an ABB pendant shows.
    #[arg(long, env = "KINCAL_SHOWN_QUATERNION", value_name = "Q1,Q2,Q3,Q4", value_parser = four_numbers, allow_hyphen_values = true)]
    shown_quaternion: Option<[f64; 4]>,
}

impl ShownOrientationArguments {
    fn stated(&self) -> Option<ShownOrientation> {
        let shown = ShownOrientation {
            kuka_abc_deg: self.shown_abc_deg,
            fanuc_wpr_deg: self.shown_wpr_deg,
            ur_rotation_vector_rad: self.shown_rotation_vector_rad,
            quaternion: self.shown_quaternion,
        };
        (shown != ShownOrientation::default()).then_some(shown)
    }
}

/// Joint values, degrees.
#[derive(Clone, Debug)]
struct Degrees(Vec<f64>);

fn degrees(text: &str) -> Result<Degrees, String> {
    numbers::all(text).map(Degrees).ok_or_else(|| {
        "numbers, such as 10 -20 30 0 45 0 or 10,-20,30,0,45,0; the robot is named by --robot, --arm or --robot-file".into()
    })
}

fn four_numbers(text: &str) -> Result<[f64; 4], String> {
    numbers::exactly(text, "four numbers are needed, such as 0.43,0.39,0.79,0.17")
}

fn mounting(text: &str) -> Result<NamedMounting, String> {
    serde_json::from_value(json!(text)).map_err(|_| "floor, wall or ceiling is needed".into())
}

/// Largest plausible angle between the pose on the pendant and that of the model, degrees.
const MAX_TURNED_DEG: f64 = 2.0;

/// Runs one of the commands.
pub fn run(command: &LibraryCommand) -> anyhow::Result<()> {
    match command {
        LibraryCommand::Find(arguments) => find(arguments),
        LibraryCommand::Add(arguments) => add(arguments),
        LibraryCommand::Posture(arguments) => check_posture(arguments.as_ref()),
    }
}

fn find(arguments: &FindArguments) -> anyhow::Result<()> {
    let text = arguments.text.join(" ");
    let found = matching_arms(&text, arguments.maker.as_deref())?;
    if let Some(file) = &arguments.robot_file {
        let model = only_match(&found, &text)?;
        let body = serde_json::to_string_pretty(&model.robot)?;
        std::fs::write(file, body + "\n")
            .map_err(|e| Usage(format!("cannot write {}: {e}", file.display())))?;
        eprintln!("{} is written to {}", model.robot.name, file.display());
        return Ok(());
    }
    match found.as_slice() {
        [] => Err(Usage(format!(
            "no ready arm has {text:?} in its name; `kincal robots find` lists all; another robot is added from its URDF or a table: kincal robots add FILE"
        ))
        .into()),
        [model] => arguments.output.print(model, || model_in_words(model)),
        several => {
            let row = |model: &&RobotModel| {
                let joints = model.joints.len().to_string();
                vec![model.id.clone(), model.maker.clone(), model.name.clone(), joints]
            };
            let rows: Vec<Vec<String>> = several.iter().map(row).collect();
            let names = ["id", "maker", "name", "joints"];
            arguments.output.table(&several, &names, &rows, "")?;
            if !arguments.output.json {
                eprintln!("{} arms; next: kincal robots find ID", several.len());
            }
            Ok(())
        }
    }
}

/// The arm with exactly this id or name; otherwise all arms that match the words.
fn matching_arms(text: &str, maker: Option<&str>) -> anyhow::Result<Vec<&'static RobotModel>> {
    let all = robot_models::find(text, maker).map_err(anyhow::Error::msg)?;
    let exact = |model: &&RobotModel| {
        [&model.id, &model.name, &model.robot.name].contains(&&text.to_owned())
    };
    Ok(match all.iter().copied().find(exact) {
        Some(model) => vec![model],
        None => all,
    })
}

/// The robot of a ready arm with this id or name.
pub fn ready_arm(text: &str) -> Option<RobotBody> {
    match robot_models::called(text).ok()?[..] {
        [model] => Some(model.robot.clone()),
        _ => None,
    }
}

/// The ready arm with this id or name. An arm whose name only contains the text is another type, with other links.
fn arm_named(text: &str) -> anyhow::Result<&'static RobotModel> {
    let named = robot_models::called(text).map_err(anyhow::Error::msg)?;
    if !named.is_empty() {
        return only_match(&named, text);
    }
    let near = robot_models::find(text, None).map_err(anyhow::Error::msg)?;
    let ids: Vec<&str> = near
        .iter()
        .take(10)
        .map(|model| model.id.as_str())
        .collect();
    let near = match ids[..] {
        [] => "`kincal robots find` lists them".into(),
        _ => format!("similar names have {}", ids.join(", ")),
    };
    Err(Usage(format!("no ready arm is called {text:?}; {near}")).into())
}

fn only_match(found: &[&'static RobotModel], text: &str) -> anyhow::Result<&'static RobotModel> {
    match found {
        [model] => Ok(model),
        [] => Err(Usage(format!(
            "no ready arm is called {text:?}; `kincal robots find` lists them"
        ))
        .into()),
        several => {
            let ids: Vec<&str> = several.iter().take(10).map(|m| m.id.as_str()).collect();
            Err(Usage(format!(
                "{} ready arms have {text:?} in their names: give one of {}",
                several.len(),
                ids.join(", ")
            ))
            .into())
        }
    }
}

fn model_in_words(model: &RobotModel) -> String {
    let mut text = format!(
        "{}  ({})\n\nbase:    {}\nflange:  {}\njoints:  {}\n\n",
        model.robot.name,
        model.id,
        model.base,
        model.flange,
        model.joints.join(", ")
    );
    text += &links_table(&model.robot.links, &model.joints);
    if let Some(map) = &model.robot.joint_map {
        let map = serde_json::to_string(map).unwrap_or_default();
        text += &format!("\njoint map: {map}\n");
    }
    text += &format!(
        "\nzeros and directions: {}\n\nsources:\n",
        model.joint_map_source
    );
    for source in &model.sources {
        text += &format!("  {}", source.title);
        if source.largest_difference_mm > 0.0 {
            text += &format!(
                " (differs by up to {} mm{})",
                source.largest_difference_mm,
                source
                    .cause
                    .as_ref()
                    .map_or(String::new(), |cause| format!(": {cause}"))
            );
        }
        text.push('\n');
    }
    if !model.notes.is_empty() {
        text += &format!("\nnotes:\n  {}\n", model.notes.join("\n  "));
    }
    text + "\nnext: compare a posture with the pendant: kincal robots posture --arm "
        + &model.id
        + " DEGREES..."
}

fn links_table(links: &[LinkBody], joints: &[String]) -> String {
    let row = |(link, joint): (&LinkBody, &String)| {
        let limits = link
            .joint_limits_deg
            .map_or("–".into(), |[low, high]| format!("{low} to {high}"));
        vec![
            joint.clone(),
            link.a_mm.to_string(),
            link.alpha_deg.to_string(),
            link.d_mm.to_string(),
            link.theta_offset_deg.to_string(),
            limits,
        ]
    };
    let rows: Vec<Vec<String>> = links.iter().zip(joints).map(row).collect();
    columns(
        &[
            "joint",
            "a_mm",
            "alpha_deg",
            "d_mm",
            "theta_offset_deg",
            "limits_deg",
        ],
        &rows,
    )
}

fn add(arguments: &AddArguments) -> anyhow::Result<()> {
    let mut body = match (&arguments.arm, &arguments.file) {
        (Some(text), _) => arm_named(text)?.robot.clone(),
        (None, Some(file)) => robot_from_file(arguments, file)?,
        (None, None) => unreachable!("clap requires one of them"),
    };
    if let Some(name) = &arguments.name {
        body.name.clone_from(name);
    }
    if let Some(serial_number) = &arguments.serial_number {
        body.serial_number = Some(serial_number.clone());
    }
    if let Some(mounting) = arguments.mounting {
        body.mounting = Some(MountingBody::Named(mounting));
    }
    let robot = arguments.server.post("/v1/robots", &body)?;
    arguments.server.warn_of_duplicate_name(&body.name);
    let text = |field: &str| plain(robot[field].as_str().unwrap_or_default());
    arguments.output.print(&robot, || {
        format!(
            "{} is {}; next: compare a posture with the pendant: kincal robots posture --robot {} DEGREES...",
            text("name"),
            text("id"),
            text("id")
        )
    })
}

/// A robot from a file: a robot file, a URDF or a table.
fn robot_from_file(arguments: &AddArguments, file: &Path) -> anyhow::Result<RobotBody> {
    let bytes = read(file)?;
    let is_json = file
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("json"));
    if is_json && arguments.convention.is_none() {
        return parse_json(file, &bytes, "a robot");
    }
    let format = format_of(file, arguments.convention)?;
    let stem = file.file_stem().map_or_else(
        || "imported robot".into(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    let tip = arguments.tip.as_deref();
    let imported = import_with(&bytes, format, arguments.digits, &stem, tip)
        .map_err(|invalid| Usage(cannot_be_used(file, &invalid.issues)))?;
    print_notes(&imported);
    Ok(imported.robot)
}

fn check_posture(arguments: &PostureArguments) -> anyhow::Result<()> {
    let request = PostureBody {
        q_deg: arguments.q_deg.iter().flat_map(|q| q.0.clone()).collect(),
        tool: arguments.tool_mm.map(|translation_mm| ToolBody {
            translation_mm,
            ..ToolBody::default()
        }),
        shown_position_mm: arguments.shown_mm,
        shown_orientation: arguments.shown_orientation.stated(),
    };
    let body = match (&arguments.arm, &arguments.robot_file) {
        (Some(text), _) => Some(arm_named(text)?.robot.clone()),
        (_, Some(file)) => Some(parse_json::<RobotBody>(file, &read(file)?, "a robot")?),
        _ => None,
    };
    let answer: Value = match body {
        Some(body) => {
            let robot = Robot::try_from(&body).map_err(|e| Usage(e.summary()))?;
            let found = posture(&request, &robot).map_err(|e| Usage(e.summary()))?;
            serde_json::to_value(found)?
        }
        None => block_on(async {
            let client: Client = arguments.server.client()?;
            let named = arguments.robot.as_deref().unwrap_or_default();
            let id = client.robot_id(named).await?;
            let path = format!("/v1/robots/{id}/posture");
            client.send(Method::POST, &path, &request).await
        })?,
    };
    let found: PostureAnswer = serde_json::from_value(answer)?;
    arguments.output.print(&found, || posture_in_words(&found))
}

fn posture_in_words(found: &PostureAnswer) -> String {
    let [x, y, z] = found.position_mm.map(|mm| fixed(mm, 3));
    let four = |numbers: &[f64]| {
        let texts: Vec<String> = numbers.iter().map(|n| fixed(*n, 4)).collect();
        texts.join("  ")
    };
    let mut text =
        format!("position               X {x}  Y {y}  Z {z} mm, in the robot's base frame\n");
    for row in &found.rotation {
        text += &format!("rotation matrix        {}\n", four(row));
    }
    text += &format!("quaternion (ABB q1-q4) {}\n", four(&found.quaternion));
    text += &format!("KUKA A B C             {} deg\n", four(&found.kuka_abc_deg));
    text += &format!(
        "FANUC W P R            {} deg (Yaskawa Rx Ry Rz)\n",
        four(&found.fanuc_wpr_deg)
    );
    text += &format!(
        "UR rotation vector     {} rad",
        four(&found.ur_rotation_vector_rad)
    );
    if found.angles_not_unique {
        text += "\nnote: B (P) is at 90°: of A and C (W and R) only the sum or the difference has a meaning";
    }
    if !found.outside_limits.is_empty() {
        text += &format!(
            "\nnote: joints outside their limits: {:?}",
            found.outside_limits
        );
    }
    if let Some(apart) = found.position_apart_mm {
        text += &format!("\nthe pendant's position is {apart:.3} mm from the model's");
        let height_mm = found
            .position_mm
            .iter()
            .map(|mm| mm * mm)
            .sum::<f64>()
            .sqrt();
        if apart > MAX_APART * height_mm {
            text += ": more than robots of one type differ. Select the flange on the pendant (a tool of zeros) or give --tool-mm, and select no user \
                     frame. If the distance stays, a zero, sign or coupling of a joint differs, or the type does";
        }
    }
    if let Some(apart) = found.orientation_apart_deg {
        text += &format!("\nthe pendant's orientation is {apart:.3}° from the model's");
        if apart > MAX_TURNED_DEG {
            text += ": more than robots of one type differ. Check the joint values, above all the last one, and the convention of the angles, and select the \
                     flange on the pendant. If the angle stays, the zero or sign of a joint differs, or the flange is turned in the controller";
        }
    }
    if !found.unchecked_joints.is_empty() {
        text += &format!(
            "\nnote: not checked: joints {:?}, which hardly move this position. Give the orientation that the pendant shows, too: --shown-abc-deg (KUKA), \
             --shown-wpr-deg (FANUC, Yaskawa), --shown-rotation-vector-rad (UR) or --shown-quaternion (ABB)",
            found.unchecked_joints
        );
    }
    text
}
