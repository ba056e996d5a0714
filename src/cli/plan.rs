//! `kincal plan`: plans which configurations to measure, offline or for a robot of a server.

use super::calibrate::read_robot;
use super::client::ServerArguments;
use super::files::{NumberFormat, cannot_be_used, issue_in_words, parse_json, read};
use super::runtime::block_on;
use super::terminal::{self, Output};
use super::usage::Usage;
use crate::operations::plan_poses;
use crate::wire::columns::ColumnsBody;
use crate::wire::decimals::fixed;
use crate::wire::issue::Issue;
use crate::wire::job::Model;
use crate::wire::measurement::{Frame, Upload, from_file};
use crate::wire::pose_plan::{PlanKind, PosePlanAnswer, PosePlanBody};
use anyhow::Context;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Number of configurations if neither the command line nor the request states one.
const DEFAULT_CONFIGURATIONS: usize = 50;

/// Plan which configurations to measure.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Robot file: the body of POST /v1/robots. It should have joint limits; a joint without limits gets -90° to 90°.
    /// Instead of it, --robot names a robot of a server.
    #[arg(value_name = "ROBOT.json", required_unless_present = "robot_on_server")]
    robot: Option<PathBuf>,
    /// Plan for this robot of the server: its id, name or serial number.
    #[arg(
        long = "robot",
        id = "robot_on_server",
        env = "KINCAL_ROBOT",
        value_name = "ROBOT"
    )]
    robot_on_server: Option<String>,
    #[command(flatten)]
    server: ServerArguments,
    /// Number of configurations, repeats included [default: that of --request, else 50].
    #[arg(short = 'n', long = "configurations", env = "KINCAL_CONFIGURATIONS")]
    n_configurations: Option<usize>,
    /// A file with the body of POST /v1/robots/{id}/pose-plans: boxes, set-ups, reflector and so on. Options of the command line override it.
    #[arg(long, env = "KINCAL_REQUEST", value_name = "REQUEST.json")]
    request: Option<PathBuf>,
    /// Sets that were already measured, in the frame given by --frame: files, or with --robot the ids of sets on the server.
    #[arg(
        long,
        env = "KINCAL_MEASURED",
        value_name = "SET.csv|ID",
        value_delimiter = ','
    )]
    measured: Vec<PathBuf>,
    #[command(flatten)]
    numbers: NumberFormat,
    /// Frame of the measurement [default: that of --request, else instrument; required with --measured].
    #[arg(long, env = "KINCAL_FRAME", value_enum)]
    frame: Option<Frame>,
    /// What is measured at each configuration [default: that of --request, else position].
    #[arg(long, env = "KINCAL_PLAN_KIND", value_enum)]
    kind: Option<PlanKind>,
    /// The model that will be identified [default: complete].
    #[arg(long, env = "KINCAL_MODEL", value_enum)]
    model: Option<Model>,
    /// Seed of the random candidates [default: that of --request, else 0].
    #[arg(long, env = "KINCAL_SEED")]
    seed: Option<u64>,
    #[command(flatten)]
    output: Output,
}

struct PlanForRobot {
    plan: PosePlanAnswer,
    /// Name of the robot, as messages show it.
    robot: String,
    /// For each joint, whether the robot has limits.
    has_limits: Vec<bool>,
}

/// Prints the plan as CSV or JSON on standard output, and its predicted uncertainty on standard error.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let body = body(arguments)?;
    if body.frame.is_none() && !arguments.measured.is_empty() {
        return Err(Usage(
            "say in which frame it was measured: --frame base or --frame instrument".into(),
        )
        .into());
    }
    let found = match (&arguments.robot, &arguments.robot_on_server) {
        (Some(path), plan_on_server) => {
            if let Some(robot) = plan_on_server {
                let file = path.display();
                eprintln!(
                    "note: planned for {file} without a server; --robot (KINCAL_ROBOT) {robot} is not used"
                );
            }
            plan_offline(arguments, path, &body)?
        }
        (None, Some(robot)) => block_on(plan_on_server(arguments, robot, body))?,
        (None, None) => return Err(Usage("give ROBOT.json, or --robot".into()).into()),
    };
    if let Some(warning) = without_limits(&found) {
        eprintln!("warning: {warning}");
    }
    for warning in &found.plan.warnings {
        eprintln!("warning: {}", warning.detail);
    }
    let plan = found.plan;
    let (planned, random) = (
        plan.predicted_std_mm.mean,
        plan.predicted_std_mm_random.mean,
    );
    eprintln!(
        "predicted uncertainty of the tool: {planned:.4} mm on average, {:.4} mm at most; random poses: {random:.4} mm ({:.2} times)",
        plan.predicted_std_mm.max,
        random / planned
    );
    if arguments.output.json {
        return terminal::json(&plan);
    }
    let header: Vec<String> = (1..=found.has_limits.len())
        .map(|joint| format!("q{joint}_deg"))
        .collect();
    let has_set_ups = !plan.set_ups.is_empty();
    let station = if has_set_ups { ",station" } else { "" };
    say!("configuration{station},{}", header.join(","));
    for (i, configuration) in plan.configurations.iter().enumerate() {
        let values: Vec<String> = configuration.q_deg.iter().map(|q| fixed(*q, 4)).collect();
        // A repeat gets the number of the configuration that it repeats, so that both are always in the same subset.
        let station = match &configuration.set_up {
            Some(name) => format!(",{}", quoted(name)),
            None => String::new(),
        };
        say!(
            "{}{station},{}",
            configuration.repeats.unwrap_or(i) + 1,
            values.join(",")
        );
    }
    Ok(())
}

/// A name as a field of a CSV row.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) || name.trim() != name {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}

/// Plans without a server.
fn plan_offline(
    arguments: &Arguments,
    path: &Path,
    body: &PosePlanBody,
) -> anyhow::Result<PlanForRobot> {
    if !body.measured.is_empty() {
        let text = "measured names sets of a server: leave it out and give their files with --measured, or name the robot with --robot";
        return Err(Usage(text.into()).into());
    }
    let robot = read_robot(path)?;
    let frame = body.frame.unwrap_or(Frame::Instrument);
    let mut measured = Vec::new();
    for path in &arguments.measured {
        let bytes = read(path)?;
        let columns = ColumnsBody::default();
        let upload = Upload {
            content_type: &arguments.numbers.content_type(path),
            bytes: &bytes,
            columns: &columns,
            decimal: None,
            rotation: None,
            frame,
            instrument: None,
        };
        let read = from_file(&upload, robot.links.len());
        let (set, _) = read.map_err(|invalid| Usage(cannot_be_used(path, &invalid.issues)))?;
        measured.push(set);
    }
    let plan = plan_poses(body, &robot, &measured).map_err(|invalid| {
        let faults: Vec<String> = invalid
            .issues
            .iter()
            .map(|issue| issue_text(arguments, issue))
            .collect();
        Usage(faults.join("\n"))
    })?;
    Ok(PlanForRobot {
        plan,
        robot: path.display().to_string(),
        has_limits: robot.joint_limits_rad.iter().map(Option::is_some).collect(),
    })
}

/// Lets the server plan for one of its robots.
async fn plan_on_server(
    arguments: &Arguments,
    robot: &str,
    mut body: PosePlanBody,
) -> anyhow::Result<PlanForRobot> {
    let ids = arguments.measured.iter();
    body.measured.extend(ids.map(|id| id.display().to_string()));
    let client = arguments.server.client()?;
    let path = format!("/v1/robots/{}", client.robot_id(robot).await?);
    let described = client.get(&path).await?;
    let answer = client
        .send(reqwest::Method::POST, &format!("{path}/pose-plans"), &body)
        .await?;
    let links = described["links"].as_array();
    Ok(PlanForRobot {
        plan: serde_json::from_value(answer)
            .context("the server's answer is of another version of kincal")?,
        robot: robot.to_owned(),
        has_limits: links
            .into_iter()
            .flatten()
            .map(|link| !link["joint_limits_deg"].is_null())
            .collect(),
    })
}

/// The request: its file, overridden by the options of the command line.
fn body(arguments: &Arguments) -> anyhow::Result<PosePlanBody> {
    let mut body = match &arguments.request {
        Some(path) => request(path)?,
        None => PosePlanBody::new(DEFAULT_CONFIGURATIONS),
    };
    body.n_configurations = arguments.n_configurations.unwrap_or(body.n_configurations);
    body.seed = arguments.seed.unwrap_or(body.seed);
    body.frame = arguments.frame.or(body.frame);
    body.model = arguments.model.or(body.model);
    body.kind = arguments.kind.or(body.kind);
    Ok(body)
}

/// Reads the request's file. Unlike the server's body it may omit the number of configurations.
fn request(path: &Path) -> anyhow::Result<PosePlanBody> {
    const WHAT: &str = "a pose plan's request";
    let mut bytes = read(path)?;
    let mut request: Value = parse_json(path, &bytes, WHAT)?;
    if request.get("n_configurations").is_none() {
        request["n_configurations"] = json!(DEFAULT_CONFIGURATIONS);
        bytes = serde_json::to_vec(&request)?;
    }
    parse_json(path, &bytes, WHAT)
}

/// An issue of the request, with its file or option.
fn issue_text(arguments: &Arguments, issue: &Issue) -> String {
    match (&arguments.request, issue.pointer.as_deref()) {
        (_, Some("/n_configurations")) if arguments.n_configurations.is_some() => {
            format!("-n: {}", issue.detail)
        }
        (Some(path), _) => format!("{}: {}", path.display(), issue_in_words(issue)),
        (None, _) => issue.detail.clone(),
    }
}

/// Warning about joints without limits.
fn without_limits(of: &PlanForRobot) -> Option<String> {
    let joints = of.has_limits.iter().enumerate();
    let joints: Vec<String> = joints
        .filter(|(_, has_limits)| !**has_limits)
        .map(|(i, _)| (i + 1).to_string())
        .collect();
    (!joints.is_empty()).then(|| {
        format!(
            "{} has no limits for joint {}: the plan takes -90° to 90° there; give joint_limits_deg with these links",
            of.robot,
            joints.join(", ")
        )
    })
}
