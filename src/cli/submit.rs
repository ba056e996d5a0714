//! `kincal submit`: a measurement set to a server, and its calibration back.

use super::calibrate::{progress_bar, show};
use super::client::{Client, ServerArguments};
use super::failure::Refused;
use super::files::{Numbers, cannot_be_used, is_json, read};
use super::terminal::Output;
use super::{Usage, block_on, table};
use crate::wire::job::{JobAnswer, JobRequestBody, Kind, Method, Model, Preset};
use crate::wire::report_shape::Report;
use crate::wire::robot::MAX_NAME;
use crate::wire::words;
use anyhow::Context;
use serde_json::Value;
use std::path::PathBuf;

/// Upload a measurement set to a server and have it identified, or verify a parameter set on it.
///
/// The JSON is the report with --wait, else the job.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot's id, name or serial number, as `kincal robots` lists them.
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT")]
    robot: String,
    /// Measurement set: CSV with units in its header, or JSON.
    #[arg(value_name = "SET.csv")]
    set: PathBuf,
    /// Frame of the measured positions.
    #[arg(long, env = "KINCAL_FRAME", default_value = "base", value_parser = ["base", "instrument"])]
    frame: String,
    #[command(flatten)]
    numbers: Numbers,
    /// Identify nothing: say how good a parameter set is on these points.
    #[arg(
        long, env = "KINCAL_VERIFY", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue,
        conflicts_with_all = ["method", "model", "preset", "seed"]
    )]
    verify: bool,
    /// With --verify: which parameter set [default: the active one, else the nominal robot].
    #[arg(long, env = "KINCAL_PARAMETERS", value_name = "ID")]
    parameters: Option<String>,
    /// How.
    #[arg(long, env = "KINCAL_METHOD", default_value = "auto", value_parser = ["auto", "least_squares", "pso", "bpnn_pso"])]
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
    /// Wait for the result, with a progress bar on a terminal.
    #[arg(long, env = "KINCAL_WAIT", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    wait: bool,
    #[command(flatten)]
    output: Output,
}

/// Uploads, asks for the job and, with `--wait`, follows it to its end.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.parameters.is_some() && !arguments.verify {
        let text = "--parameters (or KINCAL_PARAMETERS) says what is verified: give --verify with it, or leave it out to identify";
        return Err(Usage(text.into()).into());
    }
    let bytes = read(&arguments.set)?;
    block_on(async {
        let client = arguments.server.client()?;
        let robot = client.robot_id(&arguments.robot).await?;
        let set = upload(&client, arguments, &robot, bytes).await?;
        let request = serde_json::to_value(request(arguments, text(&set, "id")?)?)?;
        let posted = client
            .create(
                &format!("/v1/robots/{robot}/jobs"),
                "application/json",
                serde_json::to_vec(&request)?,
            )
            .await?;
        let job_id = text(&posted, "id")?;
        if !arguments.wait {
            let next = format!(
                "job {job_id} is queued\nnext: kincal report {job_id} once it is over (kincal jobs {job_id}), or submit with --wait"
            );
            return arguments.output.told(&posted, || next);
        }
        // who stops waiting has to name it
        eprintln!(
            "job {job_id} is queued; it goes on without this command, and `kincal cancel {job_id}` stops it"
        );
        let job = follow(&client, arguments, job_id).await?;
        let report = client.get(&format!("/v1/jobs/{job_id}/report")).await?;
        let shaped: Report = serde_json::from_value(report.clone())
            .context("the server's report is of another version of kincal")?;
        arguments.output.told(&report, || {
            let next = job.parameter_set_id.map_or(String::new(), |id| {
                format!("next: kincal release {id} --reason \"…\" if it is good; until then the cell does not get it\n")
            });
            format!("{}\n{next}to print it: kincal report {job_id} --html report.html", table::report(&shaped))
        })
    })
}

async fn upload(
    client: &Client,
    arguments: &Arguments,
    robot: &str,
    bytes: Vec<u8>,
) -> anyhow::Result<Value> {
    let content_type = if is_json(&arguments.set) {
        "application/json"
    } else {
        "text/csv"
    };
    let mut parameters = vec![("frame", arguments.frame.clone())];
    if content_type == "text/csv" {
        // a CSV has no name of its own: people know it by its file
        parameters.extend(file_name(arguments).map(|name| ("name", name)));
        parameters.extend(
            arguments
                .numbers
                .decimal_comma
                .then(|| ("decimal", "comma".into())),
        );
    }
    let path = format!("/v1/robots/{robot}/measurement-sets");
    let query = reqwest::Url::parse_with_params("http://query/", parameters)?;
    let path = format!("{path}?{}", query.query().unwrap_or_default());
    let set = client
        .create(&path, content_type, bytes.clone())
        .await
        .map_err(|error| explained(error, arguments, &bytes))?;
    for warning in set["warnings"].as_array().into_iter().flatten() {
        let (code, detail) = (
            warning["code"].as_str().unwrap_or_default(),
            warning["detail"].as_str().unwrap_or_default(),
        );
        eprintln!("warning: {} ({code}): {detail}", words::warning(code));
    }
    if !arguments.output.json {
        say!(
            "set {}: {} points, {} configurations",
            text(&set, "id")?,
            set["n_points"],
            set["n_configurations"]
        );
    }
    Ok(set)
}

/// What is wrong with the file, row by row.
fn explained(error: anyhow::Error, arguments: &Arguments, bytes: &[u8]) -> anyhow::Error {
    match error.downcast::<Refused>() {
        Ok(refused) if refused.is_usage() && !refused.problem.errors.is_empty() => Usage(
            cannot_be_used(&arguments.set, bytes, &refused.problem.errors),
        )
        .into(),
        Ok(refused) if refused.is_usage() => {
            Usage(format!("{}: {refused}", arguments.set.display())).into()
        }
        Ok(refused) => refused.into(),
        Err(error) => error,
    }
}

/// The file's name without its ending, as far as a set's name may be long.
fn file_name(arguments: &Arguments) -> Option<String> {
    let stem = arguments.set.file_stem()?.to_str()?;
    let name: String = stem
        .chars()
        .filter(|c| !c.is_control())
        .take(MAX_NAME)
        .collect();
    (!name.trim().is_empty()).then_some(name)
}

async fn follow(client: &Client, arguments: &Arguments, job_id: &str) -> anyhow::Result<JobAnswer> {
    let bar = (!arguments.output.json).then(|| progress_bar("waiting for a worker"));
    let moved = |job: &JobAnswer| {
        if let (Some(bar), Some(progress)) = (&bar, &job.progress) {
            show(
                bar,
                progress.iteration,
                progress.n_iterations,
                progress.best_cost_mm2.unwrap_or(f64::NAN),
            );
        }
    };
    let job = client.follow(job_id, moved).await;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    job
}

fn request(arguments: &Arguments, set_id: &str) -> anyhow::Result<JobRequestBody> {
    if arguments.verify {
        return Ok(JobRequestBody {
            kind: Kind::Verify,
            parameter_set_id: arguments.parameters.clone(),
            ..JobRequestBody::for_set(set_id)
        });
    }
    Ok(JobRequestBody {
        method: Method::parse(&arguments.method).context("--method")?,
        model: arguments.model.as_deref().and_then(Model::parse),
        preset: Preset::parse(&arguments.preset).context("--preset")?,
        seed: arguments.seed,
        ..JobRequestBody::for_set(set_id)
    })
}

fn text<'a>(answer: &'a Value, field: &str) -> anyhow::Result<&'a str> {
    answer[field]
        .as_str()
        .with_context(|| format!("the server's answer has no {field}"))
}
