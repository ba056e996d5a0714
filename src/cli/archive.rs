//! `kincal archive|restore`: puts items away by their ids, and takes them back.

use super::client::{Client, ServerArguments};
use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;

/// Beginnings of ids, and the paths of their items.
const PATHS: [(&str, &str); 5] = [
    ("rob_", "robots"),
    ("set_", "measurement-sets"),
    ("job_", "jobs"),
    ("par_", "parameter-sets"),
    ("net_", "networks"),
];

/// What is done with an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// It leaves the lists.
    Archive,
    /// It is in the lists again.
    Restore,
}

/// A robot, measurement set, job, candidate or network.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Ids of robots, measurement sets, jobs, parameter sets or networks.
    #[arg(value_name = "ID", required = true)]
    ids: Vec<String>,
    #[command(flatten)]
    output: Output,
}

/// `kincal archive` and `kincal restore`.
pub fn run(arguments: &Arguments, action: Action) -> anyhow::Result<()> {
    // Refuses a wrong id before anything is done.
    for id in &arguments.ids {
        path(id)?;
    }
    block_on(async {
        let client = arguments.server.client()?;
        for id in &arguments.ids {
            one(&client, id, action, &arguments.output).await?;
        }
        Ok(())
    })
}

fn path(id: &str) -> Result<String, Usage> {
    let found = PATHS.iter().find(|(prefix, _)| id.starts_with(prefix));
    found
        .map(|(_, path)| format!("/v1/{path}/{id}"))
        .ok_or_else(|| {
            Usage(format!(
                "{id:?} is no id of a robot, measurement set, job, parameter set or network; the lists show ids (kincal robots, sets, jobs, params, networks)"
            ))
        })
}

/// Archives or restores one item, and prints it.
pub async fn one(client: &Client, id: &str, action: Action, output: &Output) -> anyhow::Result<()> {
    let (verb, done) = match action {
        Action::Archive => ("archive", "archived; `kincal restore` takes it back"),
        Action::Restore => ("restore", "in use"),
    };
    let path = format!("{}/{verb}", path(id)?);
    let item = client
        .send(reqwest::Method::POST, &path, Vec::new())
        .await?;
    output.print(&item, || format!("{id} is {done}"))
}
