//! `kincal export`: a parameter set in a format of other software or of a controller.

use super::files::read;
use super::runtime::block_on;
use super::subject::{ParameterSetArgument, SetOfRobot, item, with_query};
use super::terminal;
use super::usage::Usage;
use crate::wire::export::ExportFormat;
use anyhow::Context;
use clap::ValueEnum;
use reqwest::Method;
use std::path::PathBuf;

/// A parameter set in a format of other software or of a controller.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    set: ParameterSetArgument,
    /// Format of the export.
    #[arg(
        long,
        env = "KINCAL_FORMAT",
        value_enum,
        default_value = "json",
        conflicts_with = "patch"
    )]
    format: ExportFormat,
    /// Export links with beta = 0 that come nearest to the identified links over the workspace, for controllers without beta.
    #[arg(
        long, env = "KINCAL_REFIT_BETA", conflicts_with = "patch", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    refit_beta: bool,
    /// URDF of the nominal robot. It is returned with the joint origins of the identified robot; nothing else changes.
    #[arg(long, env = "KINCAL_PATCH", value_name = "URDF")]
    patch: Option<PathBuf>,
    /// With --patch: the link at the end of the robot, if there are several.
    #[arg(long, env = "KINCAL_TIP", value_name = "LINK", requires = "patch")]
    tip: Option<String>,
    /// Write the export into this file instead of standard output.
    #[arg(short, long, env = "KINCAL_OUTPUT", value_name = "FILE")]
    output: Option<PathBuf>,
    /// The same as --format json.
    #[arg(long, env = "KINCAL_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Prints the export, or writes it into a file.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    // Not declared as a conflict in clap, because clap takes KINCAL_JSON=0 as given.
    if arguments.json && (arguments.patch.is_some() || arguments.format != ExportFormat::Json) {
        let text = "--json (KINCAL_JSON) goes with neither --patch nor another --format";
        return Err(Usage(text.into()).into());
    }
    let patch = arguments.patch.as_deref().map(read).transpose()?;
    let format = arguments.format.to_possible_value();
    let format = format.map_or("json".to_owned(), |format| format.get_name().to_owned());
    let mut query = vec![(
        "format",
        if patch.is_some() {
            "urdf".to_owned()
        } else {
            format
        },
    )];
    if arguments.refit_beta {
        query.push(("beta", "refit".into()));
    }
    query.extend(arguments.tip.clone().map(|tip| ("tip", tip)));
    let set = &arguments.set;
    let text = block_on(async {
        let client = set.server.client()?;
        let id = set.id(&client, SetOfRobot::Active).await?;
        let path = with_query(&item("parameter-sets", &id, "/export")?, &query)?;
        match patch {
            Some(urdf) => {
                client
                    .write(Method::POST, &path, "application/xml", urdf)
                    .await
            }
            None => client.read(&path).await,
        }
    })?;
    match &arguments.output {
        Some(file) => {
            std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))
        }
        None => {
            terminal::raw(text);
            Ok(())
        }
    }
}
