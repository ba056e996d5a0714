//! `kincal calibrate`: offline, no server, no database.

use super::files::{Numbers, cannot_be_used, fault, read, read_json};
use super::terminal::Output;
use super::{Usage, table};
use crate::calibration::alignment::{self, Finding, Look};
use crate::jobs::JobFailure;
use crate::jobs::execution;
use crate::kinematics::Robot;
use crate::report_page::{self, MeasuredSet, Sources};
use crate::wire::job::{JobParts, JobRequestBody, Method, Model, Preset};
use crate::wire::measurement::{self, Frame, MeasurementSet};
use crate::wire::report_shape::Report;
use crate::wire::robot::RobotBody;
use crate::wire::{Issue, Problem, canonical, words};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// The id that an offline report has in place of a job's.
const OFFLINE: &str = "offline";

/// Identify a robot from two files.
///
/// The JSON is the report.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Robot file: the body of POST /v1/robots.
    #[arg(value_name = "ROBOT.json")]
    robot: PathBuf,
    /// Measurement set: CSV with units in its header, or JSON.
    #[arg(value_name = "SET.csv")]
    set: PathBuf,
    /// Frame of the measured positions.
    #[arg(long, env = "KINCAL_FRAME", default_value = "base", value_parser = ["base", "instrument"])]
    frame: String,
    #[command(flatten)]
    numbers: Numbers,
    /// How: auto, least_squares or pso.
    #[arg(long, env = "KINCAL_METHOD", default_value = "auto", value_parser = ["auto", "least_squares", "pso"])]
    method: String,
    /// Which parameters exist [default: paper for frame base, else complete].
    #[arg(long, env = "KINCAL_MODEL", value_parser = ["paper", "complete"])]
    model: Option<String>,
    /// Where options come from.
    #[arg(long, env = "KINCAL_PRESET", default_value = "default", value_parser = ["default", "paper"])]
    preset: String,
    /// Seed of every random number.
    #[arg(long, env = "KINCAL_SEED", default_value_t = 0)]
    seed: u64,
    /// Least squares after a swarm [default: true, false in preset paper].
    #[arg(long, env = "KINCAL_REFINE")]
    refine: Option<bool>,
    #[command(flatten)]
    output: Output,
    /// Write the report as a page to print into this file, too.
    #[arg(long, env = "KINCAL_HTML", value_name = "FILE")]
    html: Option<PathBuf>,
}

/// Runs it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let robot_body = read_robot_body(&arguments.robot)?;
    let robot = robot_body
        .to_core()
        .map_err(|invalid| Usage(cannot_be_used(&arguments.robot, &[], &invalid.issues)))?;
    let frame = Frame::parse(&arguments.frame).context("--frame is base or instrument")?;
    let bytes = read(&arguments.set)?;
    let set = measurement::from_upload(
        &arguments.numbers.content_type(&arguments.set),
        &bytes,
        frame,
        robot.links.len(),
    )
    .map_err(|invalid| Usage(cannot_be_used(&arguments.set, &bytes, &invalid.issues)))?;
    // of too few poses the calibration itself speaks; nothing is kept here that could verify
    for remark in measurement::warnings(&robot, &set)
        .into_iter()
        .filter(|remark| remark.code != "under_determined")
    {
        eprintln!(
            "warning: {} ({}): {}",
            words::warning(&remark.code),
            remark.code,
            remark.detail
        );
    }
    look(&robot, &set, &arguments.set)?;
    let measured = MeasuredSet {
        name: arguments.set.file_name().and_then(|name| name.to_str()),
        frame,
        n_points: set.points.len(),
        n_configurations: measurement::counts(&set).0,
        sha256: &canonical::sha256_hex(&bytes),
    };
    let parts = JobParts {
        robot,
        set,
        verify_set: None,
        frames: None,
        network: None,
        residual_network: None,
        previous: None,
    };
    let request = body(arguments)?.to_core(parts).map_err(|invalid| {
        let faults: Vec<String> = invalid
            .issues
            .iter()
            .map(|issue| fault(issue, None))
            .collect();
        Usage(faults.join("\n"))
    })?;
    let bar = (!arguments.output.json).then(|| progress_bar("iterations"));
    let mut monitor = |progress: crate::jobs::Progress| {
        if let Some(bar) = &bar {
            show(
                bar,
                progress.iteration,
                progress.n_iterations,
                progress.best_cost_mm2,
            );
        }
        ControlFlow::Continue(())
    };
    let calibrated = execution::calibrated(&request, &mut monitor).map_err(failure)?;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let report = calibrated.report(OFFLINE, None, false)?;
    if let Some(path) = &arguments.html {
        let convergence = calibrated.convergence();
        let sources = Sources {
            robot: &robot_body,
            set: measured,
            job: None,
            parameter_set: None,
            report: &report,
            convergence: &convergence,
        };
        std::fs::write(path, report_page::html(&sources))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    print(arguments, &report)
}

/// Whether the set can have been measured on this robot, as a server asks of an upload: units, columns and joints that are not what they are
/// said to be can give a fit that looks perfect.
fn look(robot: &Robot, set: &MeasurementSet, path: &Path) -> anyhow::Result<()> {
    let Look::Off(rms_mm) = alignment::look(robot, set) else {
        return Ok(());
    };
    match alignment::explain(robot, set, rms_mm, &[]) {
        Finding::Odd { code, detail } => {
            eprintln!("warning: {} ({code}): {detail}", words::warning(code))
        }
        Finding::Wrong {
            code,
            columns,
            detail,
        } => {
            let issue = Issue {
                column: columns,
                code: code.into(),
                detail,
                ..Issue::default()
            };
            return Err(Usage(cannot_be_used(path, &[], &[issue])).into());
        }
    }
    Ok(())
}

fn print(arguments: &Arguments, report: &Report) -> anyhow::Result<()> {
    if arguments.output.json {
        say!("{}", serde_json::to_string_pretty(report)?);
    } else {
        say!("{}", table::report(report));
    }
    Ok(())
}

fn body(arguments: &Arguments) -> anyhow::Result<JobRequestBody> {
    let method: Method = serde_json::from_value(arguments.method.clone().into())?;
    let preset: Preset = serde_json::from_value(arguments.preset.clone().into())?;
    let model: Option<Model> = arguments
        .model
        .clone()
        .map(|m| serde_json::from_value(m.into()))
        .transpose()?;
    Ok(JobRequestBody {
        method,
        preset,
        model,
        seed: arguments.seed,
        refine: arguments.refine,
        ..JobRequestBody::for_set(OFFLINE)
    })
}

/// A robot file, after every check.
pub fn read_robot(path: &Path) -> anyhow::Result<crate::kinematics::Robot> {
    Ok(read_robot_body(path)?
        .to_core()
        .map_err(|invalid| Usage(cannot_be_used(path, &[], &invalid.issues)))?)
}

fn read_robot_body(path: &Path) -> anyhow::Result<RobotBody> {
    read_json(path, "a robot")
}

fn failure(failure: JobFailure) -> anyhow::Error {
    match failure {
        JobFailure::Cancelled => anyhow::anyhow!("cancelled"),
        JobFailure::Failed { problem_json } => {
            let problem: Option<Problem> = serde_json::from_str(&problem_json).ok();
            match problem {
                Some(p) if p.status < 500 => Usage(format!("{} ({})", p.detail, p.code)).into(),
                Some(p) => anyhow::anyhow!("{} ({})", p.detail, p.code),
                None => anyhow::anyhow!("{problem_json}"),
            }
        }
    }
}

/// A bar with the smallest F beside it; it draws itself on a terminal only.
pub fn progress_bar(what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(0);
    let style = ProgressStyle::with_template("{bar:32} {pos}/{len} {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.set_style(style);
    bar.set_message(what);
    bar
}

/// Moves the bar.
pub fn show(bar: &ProgressBar, iteration: u64, n_iterations: u64, best_cost_mm2: f64) {
    bar.set_length(n_iterations);
    bar.set_position(iteration);
    bar.set_message(format!(
        "iterations, F = {} mm²",
        table::number(best_cost_mm2)
    ));
}
