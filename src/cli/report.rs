//! `kincal report`: the report of a job.

use super::calibrate::refuse_unusable;
use super::subject::JobArgument;
use super::table;
use super::usage::Usage;
use crate::wire::report_shape::Report;
use anyhow::Context;
use std::path::PathBuf;

/// Show the report of a job.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    job: JobArgument,
    /// Write the report as a printable HTML page into this file instead of printing it.
    #[arg(long, env = "KINCAL_HTML", value_name = "FILE")]
    html: Option<PathBuf>,
}

/// Prints the report, or writes it as a page. Printing a report of an unusable result ends with an error, so that no script continues with it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let of = &arguments.job;
    if let Some(file) = &arguments.html {
        // Not declared as a conflict in clap, because clap takes KINCAL_JSON=0 as given.
        if of.output.json {
            return Err(Usage("--html and --json exclude each other".into()).into());
        }
        return std::fs::write(file, of.read("/report.html")?)
            .with_context(|| format!("cannot write {}", file.display()));
    }
    let report = of.get("/report")?;
    let parsed: Report = serde_json::from_value(report.clone())
        .context("the server's report is of another version of kincal")?;
    of.output.print(&report, || table::report(&parsed))?;
    refuse_unusable(&parsed, Some(&of.id))
}
