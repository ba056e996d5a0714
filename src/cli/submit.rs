//! `kincal submit`: uploads a measurement set to a server and has it calibrated.

use super::calibrate::{progress_bar, refuse_unusable, show};
use super::client::{Client, ServerArguments};
use super::failure::ServerProblem;
use super::files::cannot_be_used;
use super::measured::{
    MeasurementFiles, TableOptions, in_words as understood_in_words, read_measurement_files,
};
use super::options::{IdentifyOptions, SessionOptions, SetOptions};
use super::remedy::in_commands;
use super::runtime::block_on;
use super::subject::with_query;
use super::table;
use super::terminal::{self, Output, plain};
use super::usage::Usage;
use crate::release::headline;
use crate::wire::instrument::InstrumentBody;
use crate::wire::job::{After, JobRequestBody, Kind};
use crate::wire::job_answer::{JobAnswer, JobStatus};
use crate::wire::release::GatesAnswer;
use crate::wire::report_shape::Report;
use crate::wire::robot::MAX_NAME;
use crate::wire::understood::Reading;
use crate::wire::warning::Warning;
use anyhow::Context;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Upload a measurement set to a server and have it identified, verify a parameter set on it, or check with few poses whether the released set
/// still holds.
///
/// With --json, the output is the report if --wait is given, else the job.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot's id, name or serial number, as `kincal robots` lists them.
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT")]
    robot: String,
    /// Measurement set: a table (CSV, xlsx, ods), or JSON; `-` reads the standard input. If there are two files, the robot's file. Instead of a file, the id
    /// of a set on the server.
    #[arg(value_name = "SET.csv|ID")]
    set: PathBuf,
    #[command(flatten)]
    table: TableOptions,
    #[command(flatten)]
    sessions: SessionOptions,
    #[command(flatten)]
    set_options: SetOptions,
    /// Name of the set [default: the file's].
    #[arg(long, env = "KINCAL_NAME", value_name = "TEXT")]
    name: Option<String>,
    /// Serial number of the robot that was measured; an upload for another robot is refused.
    #[arg(long, env = "KINCAL_SERIAL_NUMBER", value_name = "TEXT")]
    serial_number: Option<String>,
    /// Mapping of columns that the robot has under this name (`kincal columns keep`).
    #[arg(long, env = "KINCAL_KEPT", value_name = "NAME", conflicts_with_all = ["columns", "column", "joint_unit", "position_unit"])]
    kept: Option<String>,
    /// Do not identify; score a parameter set on these points.
    #[arg(
        long, env = "KINCAL_VERIFY", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue,
        conflicts_with_all = ["method", "model", "preset", "seed", "hold", "only", "prior", "corrections", "verify_fraction"]
    )]
    verify: bool,
    /// Do not identify; check with five to ten configurations, or more, whether the released set still holds.
    #[arg(
        long, env = "KINCAL_CHECK", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue,
        conflicts_with_all = ["verify", "upload_only", "method", "model", "preset", "seed", "hold", "only", "prior", "corrections", "verify_fraction"]
    )]
    check: bool,
    /// With --check: what happened to the robot before. Parameters that this event may have changed are suspected first.
    #[arg(long, env = "KINCAL_AFTER", value_name = "EVENT", requires = "check")]
    after: Option<After>,
    /// With --verify or --check: the parameter set to score [default: the active one; with --verify the nominal robot if none is active].
    #[arg(long, env = "KINCAL_PARAMETERS", value_name = "ID")]
    parameters: Option<String>,
    #[command(flatten)]
    identify: IdentifyOptions,
    /// Name of the reference that the instrument measured (`kincal references`).
    #[arg(long, env = "KINCAL_REFERENCE", value_name = "NAME")]
    reference: Option<String>,
    /// Upload the set and post no job.
    #[arg(
        long, env = "KINCAL_UPLOAD_ONLY", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue,
        conflicts_with_all = ["verify", "wait"]
    )]
    upload_only: bool,
    /// Wait for the result; shows a progress bar on a terminal.
    #[arg(long, env = "KINCAL_WAIT", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    wait: bool,
    #[command(flatten)]
    output: Output,
}

/// Uploads the set, posts the job and, with `--wait`, follows it to its end.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.parameters.is_some() && !arguments.verify && !arguments.check {
        let text = "--parameters (or KINCAL_PARAMETERS) says what is verified or checked: give --verify or --check with it, or leave it out to identify";
        return Err(Usage(text.into()).into());
    }
    if !arguments.sessions.session.is_empty() && (arguments.verify || arguments.check) {
        let text = "--session (or KINCAL_SESSION) identifies from several sessions: --verify and --check score one set at a time";
        return Err(Usage(text.into()).into());
    }
    let paths = std::iter::once(&arguments.set).chain(&arguments.sessions.session);
    let sources: Vec<Source<'_>> = paths
        .map(|path| Source::from_path(path, &arguments.table))
        .collect::<anyhow::Result<_>>()?;
    block_on(async {
        let client = arguments.server.client()?;
        let robot = client.robot_id(&arguments.robot).await?;
        let mut sets = Vec::new();
        for source in sources {
            sets.push(match source {
                Source::OnServer(id) => client.get(&format!("/v1/measurement-sets/{id}")).await?,
                Source::Files(path, files) => {
                    upload(&client, arguments, &robot, path, files).await?
                }
            });
        }
        if arguments.upload_only {
            return match sets.as_slice() {
                _ if !arguments.output.json => Ok(()),
                [set] => terminal::json(set),
                sets => terminal::json(&sets),
            };
        }
        let ids = sets.iter().map(|set| Ok(text(set, "id")?.to_owned()));
        let ids: Vec<String> = ids.collect::<anyhow::Result<_>>()?;
        let request = request(arguments, &ids);
        let posted = client
            .send(
                reqwest::Method::POST,
                &format!("/v1/robots/{robot}/jobs"),
                &request,
            )
            .await?;
        let job_id = text(&posted, "id")?;
        if !arguments.wait {
            let next = format!(
                "job {job_id} is queued\nnext: kincal report {job_id} once it is over (kincal jobs {job_id}), or submit with --wait"
            );
            return arguments.output.print(&posted, || next);
        }
        // A user who stops waiting needs the id.
        eprintln!(
            "job {job_id} is queued; it goes on without this command, and `kincal cancel {job_id}` stops it"
        );
        let job = follow(&client, arguments, job_id).await?;
        let report = client.get(&format!("/v1/jobs/{job_id}/report")).await?;
        let parsed: Report = serde_json::from_value(report.clone())
            .context("the server's report is of another version of kincal")?;
        let next = match job.parameter_set_id.as_deref() {
            Some(id) if !arguments.output.json => next_step(&client, id, &sets).await?,
            _ => String::new(),
        };
        arguments.output.print(&report, || {
            if headline(&parsed).is_some() {
                return table::report(&parsed);
            }
            format!(
                "{}\n{next}to print it: kincal report {job_id} --html report.html",
                table::report(&parsed)
            )
        })?;
        refuse_unusable(&parsed, Some(job_id))
    })
}

/// The next step for a parameter set: its release if every gate is passed, otherwise the gates that failed.
async fn next_step(client: &Client, id: &str, sets: &[Value]) -> anyhow::Result<String> {
    if sets.iter().any(|set| !set["insisted_on"].is_null()) {
        return Ok(
            "next: submit a set that passes the upload check; one that was insisted on cannot lead to a release\n"
                .into(),
        );
    }
    let answer = client
        .get(&format!("/v1/parameter-sets/{id}/gates"))
        .await?;
    let answer: GatesAnswer = serde_json::from_value(answer)
        .context("the server's gates are of another version of kincal")?;
    if answer.releasable {
        return Ok(format!(
            "next: kincal release {id} --reason \"…\" if it is good; until then the cell does not get it\n"
        ));
    }
    let failed = answer.gates.iter().filter(|gate| !gate.passed);
    let failed: String = failed
        .map(|gate| {
            format!(
                "  {}: {}\n",
                gate.gate,
                in_commands(&gate.gate, &gate.detail)
            )
        })
        .collect();
    Ok(format!(
        "not releasable yet (kincal params --gates {id}):\n{failed}"
    ))
}

/// Where a measurement set comes from.
enum Source<'a> {
    /// The id of a set that the server has.
    OnServer(&'a str),
    /// Files to upload, and the path of the first one.
    Files(&'a Path, MeasurementFiles),
}

impl<'a> Source<'a> {
    /// An argument that is an id and no file names a set of the server.
    fn from_path(path: &'a Path, table: &TableOptions) -> anyhow::Result<Self> {
        let is_id = |text: &&str| {
            let digits = text.strip_prefix("set_").unwrap_or_default();
            digits.len() == 32 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())
        };
        let id = path.to_str().filter(is_id);
        match id.filter(|_| !path.exists()) {
            Some(id) => Ok(Self::OnServer(id)),
            None => Ok(Self::Files(path, read_measurement_files(path, table)?)),
        }
    }
}

async fn upload(
    client: &Client,
    arguments: &Arguments,
    robot: &str,
    path: &Path,
    files: MeasurementFiles,
) -> anyhow::Result<Value> {
    let mut parameters = vec![("frame", arguments.set_options.frame.as_str().to_owned())];
    let insist = arguments.set_options.insist;
    parameters.extend(insist.map(|code| ("insist", code.as_str().to_owned())));
    let instrument = arguments.set_options.noise.instrument();
    parameters.extend(instrument.iter().flat_map(InstrumentBody::parameters));
    parameters.extend(
        arguments
            .reference
            .iter()
            .map(|name| ("reference", name.clone())),
    );
    let inverse_poses = arguments.set_options.inverse_poses;
    parameters.extend(inverse_poses.then(|| ("inverse_poses", "true".into())));
    let record = arguments.set_options.record.record();
    parameters.extend(record.parameters());
    let serial_number = arguments.serial_number.clone();
    parameters.extend(serial_number.map(|text| ("serial_number", text)));
    if files.content_type != "application/json" {
        // A CSV has no name field; its file name is used.
        let name = arguments.name.clone().or_else(|| file_name(path));
        parameters.extend(name.map(|name| ("name", name)));
        parameters.extend(files.decimal.map(|_| ("decimal", "comma".into())));
        parameters.extend(
            files
                .rotation
                .map(|convention| ("rotation", convention.to_string())),
        );
        parameters.extend(arguments.kept.clone().map(|name| ("columns", name)));
        if !files.columns.0.is_empty() {
            parameters.push(("columns", serde_json::to_string(&files.columns)?));
        }
    }
    let sets = format!("/v1/robots/{robot}/measurement-sets");
    let sets = with_query(&sets, &parameters)?;
    let set = client
        .post(&sets, &files.content_type, files.bytes)
        .await
        .map_err(|error| with_file_rows(error, path))?;
    let reading: Reading = serde_json::from_value(set.clone()).unwrap_or_default();
    for line in understood_in_words(&reading) {
        eprintln!("{}", plain(&line));
    }
    let warnings: Vec<Warning> =
        serde_json::from_value(set["warnings"].clone()).unwrap_or_default();
    for warning in &warnings {
        eprintln!("{}", table::warning_in_words(warning));
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

/// The server's refusal of the file, with its rows and lines.
fn with_file_rows(error: anyhow::Error, path: &Path) -> anyhow::Error {
    match error.downcast::<ServerProblem>() {
        Ok(refused) if refused.is_usage() && !refused.problem.errors.is_empty() => {
            Usage(cannot_be_used(path, &refused.problem.errors)).into()
        }
        Ok(refused) if refused.is_usage() => Usage(format!("{}: {refused}", path.display())).into(),
        Ok(refused) => refused.into(),
        Err(error) => error,
    }
}

/// The file's name without its extension, cut to the longest name of a set.
fn file_name(path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_str()?;
    let name: String = stem
        .chars()
        .filter(|c| !c.is_control())
        .take(MAX_NAME)
        .collect();
    (!name.trim().is_empty()).then_some(name)
}

async fn follow(client: &Client, arguments: &Arguments, job_id: &str) -> anyhow::Result<JobAnswer> {
    let bar = (!arguments.output.json).then(progress_bar);
    let on_update = |job: &JobAnswer| {
        let Some(bar) = &bar else { return };
        match (job.status, &job.progress) {
            (JobStatus::Queued, _) => bar.set_message("waiting for a worker"),
            (_, Some(progress)) => show(bar, progress),
            (_, None) => bar.set_message("a worker has begun"),
        }
    };
    let job = client.follow(job_id, on_update).await;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    job
}

fn request(arguments: &Arguments, set_ids: &[String]) -> JobRequestBody {
    let set_id = set_ids.first().map_or("", String::as_str);
    if arguments.verify {
        return JobRequestBody {
            kind: Kind::Verify,
            parameter_set_id: arguments.parameters.clone(),
            ..JobRequestBody::for_set(set_id)
        };
    }
    if arguments.check {
        return JobRequestBody {
            kind: Kind::Check,
            parameter_set_id: arguments.parameters.clone(),
            after: arguments.after,
            ..JobRequestBody::for_set(set_id)
        };
    }
    arguments.identify.request(set_ids)
}

fn text<'a>(answer: &'a Value, field: &str) -> anyhow::Result<&'a str> {
    answer[field]
        .as_str()
        .with_context(|| format!("the server's answer has no {field}"))
}
