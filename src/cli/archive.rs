//! `kincal archive|restore`: archives items by their ids, and restores them.

use super::client::{Client, ServerArguments};
use super::runtime::block_on;
use super::subject::checked;
use super::terminal::Output;
use super::usage::Usage;

/// Prefix of the ids of each kind of item, and the path of its routes.
const PATHS: [(&str, &str); 5] = [
    ("rob_", "robots"),
    ("set_", "measurement-sets"),
    ("job_", "jobs"),
    ("par_", "parameter-sets"),
    ("net_", "networks"),
];

/// Operation on an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Leaves the item out of lists.
    Archive,
    /// Puts the item back into lists.
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
    // Checks all ids first, so that nothing is changed if one of them is wrong.
    for id in &arguments.ids {
        path(id)?;
    }
    block_on(async {
        let client = arguments.server.client()?;
        for id in &arguments.ids {
            one(&client, &path(id)?, action, &arguments.output).await?;
        }
        Ok(())
    })
}

fn path(id: &str) -> Result<String, Usage> {
    checked(id)?;
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
pub async fn one(
    client: &Client,
    path: &str,
    action: Action,
    output: &Output,
) -> anyhow::Result<()> {
    let (verb, done) = match action {
        Action::Archive => ("archive", "archived; `kincal restore` takes it back"),
        Action::Restore => ("restore", "in use"),
    };
    let path = format!("{path}/{verb}");
    let item = client.post(&path, "application/json", Vec::new()).await?;
    let id = item["id"].as_str().unwrap_or_default();
    output.print(&item, || format!("{id} is {done}"))
}
