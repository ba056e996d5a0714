//! `kincal calibrate`: identifies a robot offline, without server and database.

use super::files::{cannot_be_used, issue_in_words, issues_in_words, parse_json, read};

use super::measured::{TableOptions, in_words as understood_in_words, read_measurement_files};
use super::options::{IdentifyOptions, SessionOptions, SetOptions};
use super::robots::{MountingArgument, joint_map};
use super::robots_library::ready_arm;
use super::table;
use super::terminal::{Output, plain};
use super::usage::Usage;
use crate::calibration::quick_check::{CHECK_CANNOT_TELL, CHECK_CHANGED, FEW_CAUSES};
use crate::calibration::upload_checks::{
    self,
    alignment::{self, Alignment},
};
use crate::calibration::{CheckVerdict, DOES_NOT_FIT, SET_FAR_OFF, remedy_of_refusal};
use crate::jobs::JobFailure;
use crate::jobs::execution;
use crate::kinematics::Robot;
use crate::operations::rotation_convention::with_best_convention;
use crate::release::{
    accept_misfit, accept_rotations, headline, insisted_code, provenance, unread_labels,
};
use crate::report_page::words;
use crate::report_page::{self, MeasuredSet, Sources};
use crate::wire::export::ExportDocument;
use crate::wire::job::{JobParts, JobRequestBody, Method};
use crate::wire::job_answer::{ProgressAnswer, Stage};
use crate::wire::measurement::{self, MeasurementSet};
use crate::wire::policy::DecisionRule;
use crate::wire::report_shape::{CheckReport, Report};
use crate::wire::robot::RobotBody;
use crate::wire::session_record::SessionRecord;
use crate::wire::suspicion::Insist;
use crate::wire::warning::Warning;
use crate::wire::{Invalid, canonical};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Job id in an offline report.
const OFFLINE: &str = "offline";

/// Identify a robot from two files.
///
/// With --json, the output is the report.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Robot file: the body of POST /v1/robots.
    #[arg(value_name = "ROBOT.json")]
    robot: PathBuf,
    /// Measurement set: a table (CSV, xlsx, ods), or JSON; `-` reads the standard input. If there are two files, the robot's file.
    #[arg(value_name = "SET.csv")]
    set: PathBuf,
    #[command(flatten)]
    table: TableOptions,
    #[command(flatten)]
    sessions: SessionOptions,
    #[command(flatten)]
    set_options: SetOptions,
    #[command(flatten)]
    identify: IdentifyOptions,
    /// Refine the swarm's result with least squares [default: true, false in preset paper].
    #[arg(long, env = "KINCAL_REFINE")]
    refine: Option<bool>,
    /// Mounting, in place of that in the robot file: floor, wall, ceiling, or the direction of gravity in the base frame, X,Y,Z or X,Y,Z,STD_DEG.
    #[arg(
        long,
        env = "KINCAL_MOUNTING",
        value_name = "MOUNTING",
        allow_hyphen_values = true
    )]
    mounting: Option<MountingArgument>,
    /// Joint map, in place of that in the robot file: its JSON, or a file with it.
    #[arg(long, env = "KINCAL_JOINT_MAP", value_name = "JSON|FILE")]
    joint_map: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
    /// Also write the report as a printable HTML page into this file.
    #[arg(long, env = "KINCAL_HTML", value_name = "FILE")]
    html: Option<PathBuf>,
    /// Also write the identified parameters into this file, if they can be used: `kincal compensate FILE PROGRAM` reads it.
    #[arg(long, env = "KINCAL_PARAMETERS_FILE", value_name = "FILE")]
    parameters_file: Option<PathBuf>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.identify.method == Method::BpnnPso {
        let text = "bpnn_pso starts from a network, and networks are kept by a server: kincal submit --method bpnn_pso";
        return Err(Usage(text.into()).into());
    }
    let mut robot_body = read_robot_body(&arguments.robot)?;
    if let Some(MountingArgument(mounting)) = arguments.mounting {
        robot_body.mounting = Some(mounting);
    }
    if let Some(text) = &arguments.joint_map {
        robot_body.joint_map = Some(joint_map(text)?);
    }
    let robot = Robot::try_from(&robot_body)
        .map_err(|invalid| Usage(cannot_be_used(&arguments.robot, &invalid.issues)))?;
    let first = read_session(&arguments.set, &robot, arguments)?;
    let further = arguments.sessions.session.iter();
    let further: Vec<Session> = further
        .map(|path| read_session(path, &robot, arguments))
        .collect::<anyhow::Result<_>>()?;
    let all = || std::iter::once(&first).chain(&further);
    let insisted_on = all().find_map(|session| session.insisted_on);
    let record = arguments.set_options.record.record().checked();
    let record = record.map_err(|invalid| Usage(issues_in_words(&invalid.issues)))?;
    let record = SessionRecord::for_set(record, &first.set);
    let parts = JobParts {
        robot,
        sets: all().map(|session| session.set.clone()).collect(),
        verify_set: None,
        frames: None,
        network: None,
        residual_network: None,
        previous: None,
    };
    let mut request = body(arguments)
        .calibration_request(parts)
        .map_err(|invalid| {
            let issues_in_words: Vec<String> = invalid.issues.iter().map(issue_in_words).collect();
            Usage(issues_in_words.join("\n"))
        })?;
    request.refused_as = insisted_on.map(str::to_owned);
    request.unread_labels = all().find_map(|session| session.unread.clone());
    let bar = (!arguments.output.json).then(progress_bar);
    let mut monitor = |progress: ProgressAnswer| {
        if let Some(bar) = &bar {
            show(bar, &progress);
        }
        ControlFlow::Continue(())
    };
    let calibrated = execution::run_calibration(&request, &mut monitor).map_err(failure)?;
    if let Some(bar) = bar {
        bar.finish_and_clear();
    }
    let mut report = calibrated.report(OFFLINE, None, false, insisted_on)?;
    report.measured_at = record
        .as_ref()
        .and_then(|record| record.measured_at.clone());
    if let Some(path) = &arguments.html {
        let convergence = calibrated.convergence();
        let further_sets = further.iter().zip(&arguments.sessions.session);
        let further_sets: Vec<MeasuredSet<'_>> = further_sets
            .map(|(session, path)| session.measured(path, arguments))
            .collect();
        let sources = Sources {
            robot: &robot_body,
            set: MeasuredSet {
                record: record.as_ref(),
                ..first.measured(&arguments.set, arguments)
            },
            further_sets: &further_sets,
            job: None,
            parameter_set: None,
            sessions: &[],
            verified_expanded_mm: None,
            tolerance_mm: None,
            decision_rule: DecisionRule::default(),
            report: &report,
            convergence: &convergence,
        };
        std::fs::write(path, report_page::html(&sources))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    arguments.output.print(&report, || table::report(&report))?;
    refuse_unusable(&report, None)?;
    if let Some(path) = &arguments.parameters_file {
        let summary = serde_json::from_value(serde_json::to_value(&report)?)?;
        let document = ExportDocument {
            parameter_set_id: OFFLINE.into(),
            robot: robot_body,
            content: calibrated.parameters(),
            remaining_error_mm: None,
            provenance: provenance(summary, Some(arguments.set_options.frame)),
        };
        let text = serde_json::to_string_pretty(&document)?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("next: kincal compensate {} PROGRAM", path.display());
    }
    Ok(())
}

/// A file of points that has passed the checks.
struct Session {
    set: MeasurementSet,
    sha256: String,
    insisted_on: Option<&'static str>,
    /// Names the columns that are not read although they may identify the reflector or the set-up of a row.
    unread: Option<String>,
}

impl Session {
    /// Description of the file for the report page.
    fn measured<'a>(&'a self, path: &'a Path, arguments: &Arguments) -> MeasuredSet<'a> {
        MeasuredSet {
            name: path.file_name().and_then(|name| name.to_str()),
            frame: arguments.set_options.frame,
            n_points: self.set.points.len(),
            n_configurations: self.set.configurations().len(),
            sha256: &self.sha256,
            instrument: arguments.set_options.noise.instrument(),
            record: None,
        }
    }
}

/// Reads and checks one file of points.
fn read_session(path: &Path, robot: &Robot, arguments: &Arguments) -> anyhow::Result<Session> {
    let frame = arguments.set_options.frame;
    let files = read_measurement_files(path, &arguments.table)?;
    let shown = arguments.table.shown(path);
    let upload = files.upload(frame, arguments.set_options.noise.instrument());
    let (set, reading) = measurement::from_file(&upload, robot.links.len()).map_err(|invalid| {
        let invalid = with_best_convention(invalid, robot, &upload);
        Usage(cannot_be_used(&shown, &invalid.issues))
    })?;
    let set = match arguments.set_options.inverse_poses {
        true => measurement::inverted(set)
            .map_err(|invalid| Usage(cannot_be_used(path, &invalid.issues)))?,
        false => set,
    };
    for line in reading.iter().flat_map(understood_in_words) {
        eprintln!("{}", plain(&line));
    }
    // Leaves out `under_determined`: the calibration itself reports too few poses, and offline the set is not stored for a later verification.
    for warning in upload_checks::warnings(robot, &set)
        .iter()
        .filter(|warning| warning.code != "under_determined")
    {
        let warning =
            Warning::from(warning).with_point_names(|row| set.points.get(row)?.name.as_deref());
        eprintln!("{}", table::warning_in_words(&warning));
    }
    let unread = reading.as_ref().and_then(unread_labels);
    // The same checks as on a server. The fit can look perfect with wrong units, columns, rotations or joints.
    let insist = arguments.set_options.insist;
    let refused = |invalid: Invalid| Usage(cannot_be_used(&shown, &invalid.issues));
    // Rotations are checked first: if they are wrong, the positions fit badly too, and the message about rotations is more specific.
    let of_rotations = accept_rotations(robot, &set, insist).map_err(refused)?;
    let of_positions = match alignment::align(robot, &set) {
        Alignment::Fits => None,
        Alignment::Misses(rms_mm) => {
            let explanation = alignment::explain(robot, &set, rms_mm, &[]);
            Some(accept_misfit(explanation, insist, unread.as_deref()).map_err(refused)?)
        }
    };
    let mut insisted_on = None;
    for accepted in of_rotations.into_iter().chain(of_positions) {
        eprintln!("{}", table::warning_in_words(&accepted.warning));
        insisted_on = insisted_on.or(accepted.insisted_on);
    }
    Ok(Session {
        unread,
        insisted_on: insisted_on.map(Insist::as_str),
        sha256: canonical::sha256_hex(&files.bytes),
        set,
    })
}

/// Fails if the result cannot be used, so that nobody continues with it. `job_id` is the job on a server.
pub fn refuse_unusable(report: &Report, job_id: Option<&str>) -> anyhow::Result<()> {
    let code = headline(report);
    let check = report.check.as_ref();
    if let Some(check) = check.filter(|check| decides_next_step(check, code)) {
        let code = match check.verdict {
            CheckVerdict::Changed => CHECK_CHANGED,
            CheckVerdict::CannotTell => CHECK_CANNOT_TELL,
            CheckVerdict::Holds => return Ok(()),
        };
        let (what, next) = (words::warning(code), plain(&check.next));
        anyhow::bail!("{what} ({code})\nnext: {next}");
    }
    let Some(code) = code else {
        return Ok(());
    };
    let refused = insisted_code(report).map(remedy_of_refusal);
    let next = match code {
        "insisted_upload" | "session_does_not_fit" if refused.is_some() => {
            refused.unwrap_or_default()
        }
        "model_too_small" => {
            "identify with --model complete, or with --frame instrument if the positions are in an instrument's frame"
        }
        "joint_map_suspect" => {
            "compare the controller's joint values with the nominal robot, correct the robot's joint_map, and upload the file again"
        }
        "positions_computed" => "upload the positions that the instrument measured",
        "no_fit" => {
            "check the file: is it of this robot, in this frame (--frame), and do the joint values and the position of each row belong together?"
        }
        "session_does_not_fit" => {
            "check the file first: is it of this robot, in this frame (--frame), and do the joint values and the position of each row belong together? If the file is right, check these points (kincal submit --check): it names what changed. If it is the robot, identify anew; if it is base or tool, set that up anew"
        }
        "set_far_off" => {
            "check these points (kincal submit --check): it names what changed. If it is the robot, identify anew; if it is base or tool, set that up anew"
        }
        _ => "measure more poses, spread over the workspace, and identify from them",
    };
    let page = job_id.map_or(String::new(), |id| {
        format!("\nto look at it: kincal report {id} --html report.html")
    });
    anyhow::bail!("{} ({code})\nnext: {next}{page}", words::no_use(code))
}

/// Whether the check decides the next step. A file that does not fit the robot must be examined first, unless a few changes explain it.
fn decides_next_step(check: &CheckReport, headline: Option<&str>) -> bool {
    let is_explained = (1..=FEW_CAUSES).contains(&check.likeliest.len());
    match headline {
        None | Some(SET_FAR_OFF) => true,
        Some(DOES_NOT_FIT) => check.verdict == CheckVerdict::Changed && is_explained,
        Some(_) => false,
    }
}

fn body(arguments: &Arguments) -> JobRequestBody {
    let n_sessions = 1 + arguments.sessions.session.len();
    let ids = (0..n_sessions).map(|session| format!("{OFFLINE}_{session}"));
    JobRequestBody {
        refine: arguments.refine,
        ..arguments.identify.request(&Vec::from_iter(ids))
    }
}

/// Reads and checks a robot file.
pub fn read_robot(path: &Path) -> anyhow::Result<Robot> {
    Ok(Robot::try_from(&read_robot_body(path)?)
        .map_err(|invalid| Usage(cannot_be_used(path, &invalid.issues)))?)
}

fn read_robot_body(path: &Path) -> anyhow::Result<RobotBody> {
    if let Some(arm) = path.to_str().filter(|_| !path.exists()).and_then(ready_arm) {
        return Ok(arm);
    }
    if !path.exists() {
        let text = format!(
            "there is no file {0}, and no ready arm of this id: `kincal robots find` lists the arms, `kincal robots show ROBOT --json > {0}` writes a \
             server's robot",
            path.display()
        );
        return Err(Usage(text).into());
    }
    robot_file(path, &read(path)?)
}

/// Fields that a server's answer adds to the body of a robot.
const ANSWERED: [&str; 7] = [
    "id",
    "created_at",
    "version",
    "state",
    "checked",
    "archived_at",
    "updated_at",
];

/// A robot file: the body of `POST /v1/robots`, or a server's answer with it.
pub fn robot_file(path: &Path, bytes: &[u8]) -> anyhow::Result<RobotBody> {
    if let Ok(Value::Object(mut robot)) = serde_json::from_slice(bytes)
        && robot.contains_key("id")
    {
        robot.retain(|name, _| !ANSWERED.contains(&name.as_str()));
        return parse_json(path, &serde_json::to_vec(&robot)?, "a robot");
    }
    if bytes.trim_ascii_start().first() == Some(&b'<') {
        let text = format!(
            "{0} is a robot description (URDF): make a robot file of it first, kincal import {0} > ROBOT.json",
            path.display()
        );
        return Err(Usage(text).into());
    }
    parse_json(path, bytes, "a robot")
}

fn failure(failure: JobFailure) -> anyhow::Error {
    match failure {
        JobFailure::Cancelled => anyhow::anyhow!("cancelled"),
        JobFailure::Failed(p) if p.status < 500 => {
            Usage(format!("{} ({})", p.detail, p.code)).into()
        }
        JobFailure::Failed(p) => anyhow::anyhow!("{} ({})", p.detail, p.code),
    }
}

/// A progress bar with a message; it is drawn only on a terminal.
pub fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::no_length();
    let style = ProgressStyle::with_template("{bar:32} {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.set_style(style);
    bar
}

/// Updates the bar. No remaining time is predicted: only the main method has iterations, and it seldom reaches their limit.
pub fn show(bar: &ProgressBar, progress: &ProgressAnswer) {
    match has_iterations(progress) {
        true => bar.set_length(progress.n_iterations),
        // A bar without a length is drawn empty. A bar of length 0, or at its length, is drawn full.
        false => bar.unset_length(),
    }
    bar.set_position(progress.iteration);
    bar.set_message(in_words(progress));
}

/// Whether the stage has iterations to show. Older servers do not send the stage; then the number of iterations decides.
fn has_iterations(progress: &ProgressAnswer) -> bool {
    progress.stage.is_none_or(Stage::has_iterations) && progress.n_iterations > 0
}

/// Text of the bar: the stage and, if it has iterations, the iteration and the smallest F so far.
fn in_words(progress: &ProgressAnswer) -> String {
    let stage = words::stage(progress.stage);
    let cost = progress.best_cost_mm2;
    match (has_iterations(progress), cost) {
        (false, _) => format!("{stage} …"),
        (true, cost) => {
            let cost = cost.map_or(String::new(), |cost| {
                format!(", F = {} mm²", table::number(cost))
            });
            format!(
                "{stage}: iteration {} of at most {}{cost}",
                progress.iteration, progress.n_iterations
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{ProgressAnswer, Stage, in_words, progress_bar, show};

    #[test]
    fn the_bar_shows_the_iterations_of_the_main_method_and_is_empty_else() {
        let bar = progress_bar();
        assert_eq!(bar.length(), None);
        let at = |stage| {
            show(
                &bar,
                &ProgressAnswer {
                    stage: Some(stage),
                    iteration: 20,
                    n_iterations: 500,
                    best_cost_mm2: None,
                },
            );
            (bar.length(), bar.position())
        };
        assert_eq!(at(Stage::Pso), (Some(500), 20));
        assert_eq!(at(Stage::Corrections).0, None);
    }

    #[test]
    fn a_stage_without_iterations_promises_nothing() {
        let at = |stage, iteration, cost| {
            in_words(&ProgressAnswer {
                stage,
                iteration,
                n_iterations: 500,
                best_cost_mm2: cost,
            })
        };
        assert_eq!(
            at(Some(Stage::Pso), 20, Some(1.5)),
            "Particle swarm: iteration 20 of at most 500, F = 1.5000 mm²"
        );
        assert_eq!(
            at(Some(Stage::Corrections), 500, Some(1.5)),
            "Fitting corrections beyond the links …"
        );
        assert_eq!(at(None, 3, None), "Computing: iteration 3 of at most 500");
    }
}
