//! The command line. Exit codes: 0 done, 1 failed, 2 wrong usage.

#[macro_use]
mod terminal;

mod act;
mod backup;
mod calibrate;
mod client;
mod compensate;
mod completions;
mod copy_store;
mod demo;
mod failure;
mod files;
mod import;
mod key;
mod look;
mod openapi;
mod options;
mod plan;
mod report;
mod runtime;
mod serve;
mod submit;
mod table;
mod usage;
mod verify_store;
mod worker;

use clap::{CommandFactory, Parser, Subcommand};
use std::process::ExitCode;

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 failed (the server, the network, the job), 2 wrong usage (an option, a file: mend it and try again).
Each long option has an environment variable, KINCAL_…; --help of a command names them. What is decided anew each time has none: --reason,
--change-reason, and whose key `kincal key` makes or revokes (--name, --scope, --robot).

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
#[command(name = "kincal", version, about, after_help = EXIT_CODES, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the REST interface and compute calibrations.
    Serve(crate::config::ServeConfig),
    /// Compute calibrations only: a node beside others on one PostgreSQL.
    Worker(crate::config::WorkerConfig),
    /// Bring the database's schema up to date.
    Migrate(worker::MigrateArguments),
    /// Copy a whole database into an empty one of either kind.
    CopyStore(copy_store::Arguments),
    /// Make, list and revoke keys.
    Key(key::Arguments),
    /// Check that the database keeps its promises; exit code 1 if it does not.
    VerifyStore(verify_store::Arguments),
    /// Copy the embedded database while it is served, and check the copy; exit code 1 if it does not keep its promises.
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
    /// List a server's robots, or show one.
    Robots(look::Robots),
    /// List a robot's measurement sets, or show one.
    Sets(look::OfRobot),
    /// List a robot's jobs, or show one.
    Jobs(look::OfRobot),
    /// List a robot's parameter sets, or show one.
    Params(look::Params),
    /// Show the report of a job, or write it as a page to print.
    Report(report::Arguments),
    /// Make a parameter set the robot's active one.
    Release(act::Release),
    /// Take a parameter set back.
    Withdraw(act::Withdraw),
    /// Say why a robot is well in spite of a session that did not fit it.
    Checked(act::Checked),
    /// Cancel a job.
    Cancel(act::Cancel),
    /// Run the paper's calibrations through a real server on a temporary database, and print its tables beside ours.
    Demo(demo::Arguments),
    /// Print the OpenAPI document.
    Openapi(openapi::Arguments),
    /// Print shell completions: bash, zsh, fish, powershell or elvish.
    #[command(after_help = COMPLETIONS_HELP)]
    Completions(completions::Arguments),
}

/// Runs the command line.
pub fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Serve(config) => serve::run(&config),
        Command::Worker(config) => worker::run(&config),
        Command::Migrate(arguments) => worker::migrate(&arguments),
        Command::CopyStore(arguments) => copy_store::run(&arguments),
        Command::Key(arguments) => key::run(&arguments),
        Command::Backup(arguments) => backup::run(&arguments),
        Command::VerifyStore(arguments) => verify_store::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Submit(arguments) => submit::run(&arguments),
        Command::Compensate(arguments) => compensate::run(&arguments),
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Import(arguments) => import::run(&arguments),
        Command::Robots(arguments) => look::robots(&arguments),
        Command::Sets(arguments) => look::sets(&arguments),
        Command::Jobs(arguments) => look::jobs(&arguments),
        Command::Params(arguments) => look::parameter_sets(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Release(arguments) => act::release(&arguments),
        Command::Withdraw(arguments) => act::withdraw(&arguments),
        Command::Checked(arguments) => act::checked(&arguments),
        Command::Cancel(arguments) => act::cancel(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Openapi(arguments) => openapi::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments, Arguments::command()),
    };
    match result {
        Ok(()) if terminal::is_complete() => ExitCode::SUCCESS,
        Ok(()) => ExitCode::FAILURE,
        Err(error) => {
            let text = terminal::in_commands(&format!("{error:#}"));
            eprintln!("kincal: {}", terminal::plain(&text));
            let is_usage = error.is::<usage::Usage>()
                || error
                    .downcast_ref::<failure::Refused>()
                    .is_some_and(failure::Refused::is_usage);
            if is_usage {
                ExitCode::from(2)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}
