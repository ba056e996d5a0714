//! The command line. Exit codes: 0 success, 1 failure, 2 wrong usage.

#[macro_use]
mod terminal;

// The server and its database.
mod backup;
mod completions;
mod copy_store;
mod demo;
mod key;
mod openapi;
mod serve;
mod verify_store;

// Commands that send requests to a server.
mod actions;
mod archive;
mod client;
mod failure;
mod history;
mod list;
mod policy;
mod references;
mod report;
mod robots;
mod robots_library;
mod submit;

// Files of measurements, robots and programs.
mod calibrate;
mod column_options;
mod columns;
mod compensate;
mod export;
mod files;
mod frames;
mod import;
mod measured;
mod named_frames;
mod plan;
mod predict;
mod program;

// Shared by the commands: arguments, texts and tables.
mod numbers;
mod options;
mod remedy;
mod runtime;
mod subject;
mod table;
mod usage;

use clap::{CommandFactory, Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Exit codes: 0 success, 1 failure (the server, the network, the job), 2 wrong usage (an option, a file: correct it and try again).
Each long option has an environment variable, KINCAL_…; --help of a command names them. Options of a single call have none: --reason,
--change-reason, and the options of `kincal key`, `kincal robots edit` and `kincal policy set`.

First steps:
  kincal serve --no-auth                       a server on this machine, http://127.0.0.1:8080/
  kincal calibrate ROBOT.json SET.csv          without a server
  kincal submit --robot ID SET.csv --wait      through a server; `kincal robots` lists the IDs";

const COMPLETIONS_HELP: &str = "\
bash:        kincal completions bash > ~/.local/share/bash-completion/completions/kincal
zsh:         kincal completions zsh > \"${fpath[1]}/_kincal\"
fish:        kincal completions fish > ~/.config/fish/completions/kincal.fish
PowerShell:  kincal completions powershell | Out-String | Invoke-Expression";

/// Kinematic calibration of industrial robots.
#[derive(Debug, Parser)]
#[command(name = "kincal", version, about, after_help = AFTER_HELP, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the REST interface and compute calibrations.
    Serve(crate::config::ServeConfig),
    /// Compute calibrations without serving requests: one of several nodes on one PostgreSQL.
    Worker(crate::config::WorkerConfig),
    /// Bring the database's schema up to date.
    Migrate(serve::MigrateArguments),
    /// Copy a whole database into an empty one: SQLite to PostgreSQL, or back.
    CopyStore(copy_store::Arguments),
    /// Make, list and revoke keys.
    Key(key::Arguments),
    /// Check the database's integrity promises (I1 to I9); exit code 1 if one is broken.
    VerifyStore(verify_store::Arguments),
    /// Copy the embedded database while the server runs, and check the copy; exit code 1 if the check fails.
    ///
    /// Copying the data directory of a running server is no backup: its files are copied at different moments, and such copies are often
    /// broken. This command reads one consistent state.
    Backup(backup::Arguments),
    /// Identify a robot from two files, offline: no server, no database.
    Calibrate(calibrate::Arguments),
    /// Upload a measurement set to a server and have it identified.
    Submit(submit::Arguments),
    /// Correct the joint targets of a program that was made offline.
    Compensate(compensate::Arguments),
    /// Plan which configurations to measure.
    Plan(plan::Arguments),
    /// Make a robot file from a URDF or a table of Denavit-Hartenberg parameters.
    Import(import::Arguments),
    /// List a server's robots, show, add, edit, archive or restore one, find ready arms, check a posture.
    Robots(robots::Arguments),
    /// List a robot's measurement sets, or show one.
    Sets(list::SetArguments),
    /// Preview how a file would be read, and keep the meaning of its columns with a robot.
    Columns(columns::Arguments),
    /// List the jobs of all robots or of one, or show one.
    Jobs(list::JobArguments),
    /// List a robot's networks, or show one.
    Networks(list::NetworkArguments),
    /// List a robot's parameter sets, or show one.
    Params(list::ParameterSetArguments),
    /// Show the report of a job, or write it as a printable page.
    Report(report::Arguments),
    /// Find base and tool frame from sweeps of single joints.
    Frames(frames::Arguments),
    /// Check the gates of a release, without releasing; exit code 1 if the release would be refused.
    Gates(actions::GateArguments),
    /// Show or set a robot's release policy.
    Policy(policy::Arguments),
    /// List a robot's work frames, or keep one under a name.
    WorkFrames(named_frames::WorkFrameArguments),
    /// List a robot's tools, or keep one under a name.
    Tools(named_frames::ToolArguments),
    /// List a robot's references (a scale bar that the instrument measured), or store one.
    References(references::Arguments),
    /// Show which parameters moved between a robot's identifications.
    History(subject::RobotArgument),
    /// Show the differences between two parameter sets.
    Compare(history::CompareArguments),
    /// Print a parameter set in a format of other software or of a controller.
    Export(export::Arguments),
    /// Print the tool's position for joint values, computed with identified parameters.
    Predict(predict::Arguments),
    /// Archive robots, measurement sets, jobs, candidates or networks: they leave the lists.
    Archive(archive::Arguments),
    /// Restore what was archived.
    Restore(archive::Arguments),
    /// Make a parameter set the robot's active one.
    Release(actions::ReleaseArguments),
    /// Withdraw a parameter set: the cell no longer gets it.
    Withdraw(actions::DecisionArguments),
    /// Withdraw the active parameter set, and make the one that it superseded active again.
    Rollback(actions::RobotDecisionArguments),
    /// State why a robot is in order although a session did not fit it.
    Checked(actions::RobotDecisionArguments),
    /// Cancel a job.
    Cancel(subject::JobArgument),
    /// Run the paper's calibrations through a real server with a temporary database, and compare with the paper's tables.
    Demo(demo::Arguments),
    /// Print the OpenAPI document.
    Openapi(openapi::Arguments),
    /// Print shell completions: bash, zsh, fish, powershell or elvish.
    #[command(after_help = COMPLETIONS_HELP)]
    Completions(completions::Arguments),
}

/// Prefixes a list such as `-10,20,30` with a space, because clap would read it as an option.
fn as_value(argument: OsString) -> OsString {
    let is_list = |text: &str| {
        let first = text.strip_prefix('-').and_then(|rest| rest.chars().next());
        text.contains(',') && first.is_some_and(|c| c.is_ascii_digit() || c == '.')
    };
    match argument.to_str() {
        Some(text) if is_list(text) => format!(" {text}").into(),
        _ => argument,
    }
}

/// Runs the command line.
pub fn main() -> ExitCode {
    let arguments = std::env::args_os().map(as_value);
    let result = match Arguments::parse_from(arguments).command {
        Command::Serve(config) => serve::run(&config),
        Command::Worker(config) => serve::work(&config),
        Command::Migrate(arguments) => serve::migrate(&arguments),
        Command::CopyStore(arguments) => copy_store::run(&arguments),
        Command::Key(arguments) => key::run(&arguments),
        Command::Backup(arguments) => backup::run(&arguments),
        Command::VerifyStore(arguments) => verify_store::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Submit(arguments) => submit::run(&arguments),
        Command::Compensate(arguments) => compensate::run(&arguments),
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Import(arguments) => import::run(&arguments),
        Command::Robots(arguments) => robots::run(&arguments),
        Command::Sets(arguments) => list::sets(&arguments),
        Command::Jobs(arguments) => list::jobs(&arguments),
        Command::Networks(arguments) => list::networks(&arguments),
        Command::Frames(arguments) => frames::run(&arguments),
        Command::Columns(arguments) => columns::run(&arguments),
        Command::Gates(arguments) => actions::gates(&arguments),
        Command::Policy(arguments) => policy::run(&arguments),
        Command::WorkFrames(arguments) => named_frames::work_frames(&arguments),
        Command::Tools(arguments) => named_frames::tools(&arguments),
        Command::References(arguments) => references::run(&arguments),
        Command::History(arguments) => history::history(&arguments),
        Command::Compare(arguments) => history::compare(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Predict(arguments) => predict::run(&arguments),
        Command::Archive(arguments) => archive::run(&arguments, archive::Action::Archive),
        Command::Restore(arguments) => archive::run(&arguments, archive::Action::Restore),
        Command::Rollback(arguments) => actions::roll_back(&arguments),
        Command::Params(arguments) => list::parameter_sets(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Release(arguments) => actions::release(&arguments),
        Command::Withdraw(arguments) => actions::withdraw(&arguments),
        Command::Checked(arguments) => actions::checked(&arguments),
        Command::Cancel(arguments) => actions::cancel(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Openapi(arguments) => openapi::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments, Arguments::command()),
    };
    match result {
        Ok(()) if terminal::is_complete() => ExitCode::SUCCESS,
        Ok(()) => ExitCode::FAILURE,
        Err(error) => {
            let text = remedy::with_options(&format!("{error:#}"));
            eprintln!("kincal: {}", terminal::plain(&text));
            let is_usage = error.is::<usage::Usage>()
                || error
                    .downcast_ref::<failure::ServerProblem>()
                    .is_some_and(failure::ServerProblem::is_usage);
            if is_usage {
                ExitCode::from(2)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}
