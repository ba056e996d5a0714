//! `kincal gates`: checks the gates of a release, without releasing.

use super::client::ServerArguments;
use super::runtime::block_on;
use super::terminal;
use super::terminal::{Output, in_commands, plain};
use serde_json::Value;

/// Check the gates of a release of a parameter set, without releasing it.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The parameter set, as `kincal params` lists it.
    #[arg(value_name = "ID")]
    id: String,
    #[command(flatten)]
    output: Output,
}

/// `kincal gates`.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    show(&arguments.server, &arguments.id, &arguments.output)
}

/// Prints the gates of a parameter set; an error if one would refuse its release.
pub fn show(server: &ServerArguments, id: &str, output: &Output) -> anyhow::Result<()> {
    block_on(async {
        let found = server
            .client()?
            .get(&format!("/v1/parameter-sets/{id}/gates"))
            .await?;
        if output.json {
            say!("{}", serde_json::to_string_pretty(&found)?);
        } else {
            terminal::raw(gate_lines(&found));
        }
        if found["releasable"] != true {
            anyhow::bail!("a release of {id} would be refused");
        }
        Ok(())
    })
}

fn gate_lines(found: &Value) -> String {
    let line = |gate: &Value| {
        let word = match (&gate["passed"], &gate["warning"]) {
            (Value::Bool(false), _) => "REFUSED",
            (_, Value::Bool(true)) => "warning",
            _ => "passed",
        };
        format!(
            "{word:<8} {:<30} {}\n",
            plain(gate["gate"].as_str().unwrap_or_default()),
            plain(&in_commands(gate["detail"].as_str().unwrap_or_default()))
        )
    };
    found["gates"]
        .as_array()
        .into_iter()
        .flatten()
        .map(line)
        .collect()
}
