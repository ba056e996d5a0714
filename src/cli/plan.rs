//! `kincal plan`: which configurations to measure, offline.

use super::Usage;
use super::calibrate::{invalid_text, read, read_robot};
use super::terminal::Output;
use crate::wire::job::Model;
use crate::wire::json;
use crate::wire::measurement::{Frame, from_upload};
use crate::wire::pose_plan::PosePlanBody;
use std::path::PathBuf;

/// Plan which configurations to measure.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Robot file: the body of POST /v1/robots. Joint limits should stand in it.
    #[arg(value_name = "ROBOT.json")]
    robot: PathBuf,
    /// Configurations, repeats included.
    #[arg(short = 'n', long = "configurations", env = "KINCAL_CONFIGURATIONS", default_value_t = 50)]
    n_configurations: usize,
    /// Boxes, obstacles, reflector and the rest: a file with the body of POST /v1/robots/{id}/pose-plans.
    #[arg(long, env = "KINCAL_REQUEST", value_name = "REQUEST.json")]
    request: Option<PathBuf>,
    /// Sets that were measured already, in the frame given by --frame.
    #[arg(long, value_name = "SET.csv")]
    measured: Vec<PathBuf>,
    /// Frame that is measured in.
    #[arg(long, env = "KINCAL_FRAME", value_parser = ["base", "instrument"])]
    frame: Option<String>,
    /// The model that will be identified [default: complete; paper for frame base].
    #[arg(long, env = "KINCAL_MODEL", value_parser = ["paper", "complete"])]
    model: Option<String>,
    /// Seed of the candidates.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    output: Output,
}

/// Prints the plan as CSV (q1_deg …, repeats) or JSON on standard output, and how good it is on standard error.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let robot = read_robot(&arguments.robot)?;
    let mut body = match &arguments.request {
        Some(path) => json::parse(&read(path)?).map_err(|e| Usage(format!("{}: {e}", path.display())))?,
        None => PosePlanBody { seed: arguments.seed, ..PosePlanBody::of(arguments.n_configurations) },
    };
    body.frame = arguments.frame.as_deref().and_then(Frame::parse).or(body.frame);
    body.model = arguments.model.as_deref().and_then(Model::parse).or(body.model);
    let frame = body.frame.unwrap_or(Frame::Instrument);
    let mut measured = Vec::new();
    for path in &arguments.measured {
        let kind = if path.extension().is_some_and(|e| e == "json") { "application/json" } else { "text/csv" };
        let set = from_upload(kind, &read(path)?, frame, robot.links.len());
        measured.push(set.map_err(|invalid| Usage(invalid_text(path, &invalid)))?);
    }
    let plan = body.run(&robot, &measured).map_err(|invalid| Usage(invalid.summary()))?;
    let (planned, random) = (plan.predicted_std_mm.mean, plan.predicted_std_mm_random.mean);
    eprintln!(
        "predicted uncertainty of the tool: {planned:.4} mm on average, {:.4} mm at most; random poses: {random:.4} mm ({:.2} times)",
        plan.predicted_std_mm.max,
        random / planned
    );
    if arguments.output.json {
        say!("{}", serde_json::to_string_pretty(&plan)?);
        return Ok(());
    }
    let header: Vec<String> = (1..=robot.links.len()).map(|joint| format!("q{joint}_deg")).collect();
    say!("configuration,{}", header.join(","));
    for (i, configuration) in plan.configurations.iter().enumerate() {
        let values: Vec<String> = configuration.q_deg.iter().map(|q| format!("{q:.4}")).collect();
        // a repeat is the same configuration, so that it never stands on both sides of a split
        say!("{},{}", configuration.repeats.unwrap_or(i) + 1, values.join(","));
    }
    Ok(())
}
