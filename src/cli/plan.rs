//! `kincal plan`: plans which configurations to measure, offline.

use super::calibrate::read_robot;
use super::files::{NumberFormat, cannot_be_used, fault, parse_json, read};
use super::terminal::Output;
use super::usage::Usage;
use crate::kinematics::Robot;
use crate::operations::plan_poses;
use crate::wire::columns::ColumnsBody;
use crate::wire::issue::Issue;
use crate::wire::job::Model;
use crate::wire::measurement::{Frame, Upload, from_file};
use crate::wire::pose_plan::PosePlanBody;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Number of configurations if neither the command line nor the request states one.
const DEFAULT_CONFIGURATIONS: usize = 50;

/// Plan which configurations to measure.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Robot file: the body of POST /v1/robots. It should have joint limits; a joint without limits gets -90° to 90°.
    #[arg(value_name = "ROBOT.json")]
    robot: PathBuf,
    /// Number of configurations, repeats included [default: that of --request, else 50].
    #[arg(short = 'n', long = "configurations", env = "KINCAL_CONFIGURATIONS")]
    n_configurations: Option<usize>,
    /// A file with the body of POST /v1/robots/{id}/pose-plans: boxes, obstacles, reflector and so on. Options of the command line override it.
    #[arg(long, env = "KINCAL_REQUEST", value_name = "REQUEST.json")]
    request: Option<PathBuf>,
    /// Sets that were already measured, in the frame given by --frame.
    #[arg(
        long,
        env = "KINCAL_MEASURED",
        value_name = "SET.csv",
        value_delimiter = ','
    )]
    measured: Vec<PathBuf>,
    #[command(flatten)]
    numbers: NumberFormat,
    /// Frame of the measurement [default: that of --request, else instrument; required with --measured].
    #[arg(long, env = "KINCAL_FRAME", value_enum)]
    frame: Option<Frame>,
    /// The model that will be identified [default: complete].
    #[arg(long, env = "KINCAL_MODEL", value_enum)]
    model: Option<Model>,
    /// Seed of the random candidates [default: that of --request, else 0].
    #[arg(long, env = "KINCAL_SEED")]
    seed: Option<u64>,
    #[command(flatten)]
    output: Output,
}

/// Prints the plan as CSV or JSON on standard output, and its predicted uncertainty on standard error.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let robot = read_robot(&arguments.robot)?;
    let body = body(arguments)?;
    if body.frame.is_none() && !arguments.measured.is_empty() {
        return Err(Usage(
            "say in which frame it was measured: --frame base or --frame instrument".into(),
        )
        .into());
    }
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
        let (set, _) =
            read.map_err(|invalid| Usage(cannot_be_used(path, &bytes, &invalid.issues)))?;
        measured.push(set);
    }
    let plan = plan_poses(&body, &robot, &measured).map_err(|invalid| {
        let faults: Vec<String> = invalid
            .issues
            .iter()
            .map(|issue| issue_text(arguments, issue))
            .collect();
        Usage(faults.join("\n"))
    })?;
    if let Some(warning) = without_limits(&robot, &arguments.robot) {
        eprintln!("warning: {warning}");
    }
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
        say!("{}", serde_json::to_string_pretty(&plan)?);
        return Ok(());
    }
    let header: Vec<String> = (1..=robot.links.len())
        .map(|joint| format!("q{joint}_deg"))
        .collect();
    say!("configuration,{}", header.join(","));
    for (i, configuration) in plan.configurations.iter().enumerate() {
        let values: Vec<String> = configuration
            .q_deg
            .iter()
            .map(|q| format!("{q:.4}"))
            .collect();
        // A repeat has the number of its configuration, so that it is never on both sides of a split.
        say!(
            "{},{}",
            configuration.repeats.unwrap_or(i) + 1,
            values.join(",")
        );
    }
    Ok(())
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
    let body: PosePlanBody = parse_json(path, &bytes, WHAT)?;
    if !body.measured.is_empty() {
        let text = "measured names sets of a server, which is not asked here: leave it out, and give their files with --measured";
        return Err(Usage(format!("{}: {text}", path.display())).into());
    }
    Ok(body)
}

/// An issue of the request, with its file or option.
fn issue_text(arguments: &Arguments, issue: &Issue) -> String {
    match (&arguments.request, issue.pointer.as_deref()) {
        (_, Some("/n_configurations")) if arguments.n_configurations.is_some() => {
            format!("-n: {}", issue.detail)
        }
        (Some(path), _) => format!("{}: {}", path.display(), fault(issue, None)),
        (None, _) => issue.detail.clone(),
    }
}

/// Warning about joints without limits.
fn without_limits(robot: &Robot, path: &Path) -> Option<String> {
    let joints = robot
        .joint_limits_rad
        .iter()
        .enumerate()
        .filter(|(_, limits)| limits.is_none());
    let joints: Vec<String> = joints.map(|(i, _)| (i + 1).to_string()).collect();
    (!joints.is_empty()).then(|| {
        format!(
            "{} has no limits for joint {}: the plan takes -90° to 90° there; give joint_limits_deg with these links",
            path.display(),
            joints.join(", ")
        )
    })
}
