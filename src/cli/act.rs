//! `kincal release|withdraw|cancel`: what people decide.

use super::block_on;
use super::client::ServerArguments;
use super::terminal::Output;
use serde_json::{Value, json};

/// Release or withdraw a parameter set.
#[derive(Debug, clap::Args)]
pub struct Decision {
    #[command(flatten)]
    server: ServerArguments,
    /// The parameter set, as `kincal params` lists it.
    #[arg(value_name = "ID")]
    id: String,
    /// Why, for those who come after.
    #[arg(long, value_name = "TEXT")]
    reason: String,
    /// Why the robot may have changed as much as it did, where the service asks for it on a release.
    #[arg(long, value_name = "TEXT")]
    change_reason: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// Cancel a job.
#[derive(Debug, clap::Args)]
pub struct Cancel {
    #[command(flatten)]
    server: ServerArguments,
    /// The job, as `kincal jobs` lists it.
    #[arg(value_name = "ID")]
    id: String,
    #[command(flatten)]
    output: Output,
}

/// `kincal release`.
pub fn release(arguments: &Decision) -> anyhow::Result<()> {
    let mut body = json!({"reason": arguments.reason});
    if let Some(change_reason) = &arguments.change_reason {
        body["change_reason"] = json!(change_reason);
    }
    let set = decide(arguments, "release", &body)?;
    arguments.output.told(&set, || format!("{} is released: the cell gets it from now on", arguments.id))
}

/// `kincal withdraw`.
pub fn withdraw(arguments: &Decision) -> anyhow::Result<()> {
    let set = decide(arguments, "withdraw", &json!({"reason": arguments.reason}))?;
    arguments.output.told(&set, || format!("{} is withdrawn; `kincal params` shows whether another one is active", arguments.id))
}

fn decide(arguments: &Decision, action: &str, body: &Value) -> anyhow::Result<Value> {
    let path = format!("/v1/parameter-sets/{}/{action}", arguments.id);
    block_on(async { arguments.server.client()?.create(&path, "application/json", serde_json::to_vec(body)?).await })
}

/// `kincal cancel`.
pub fn cancel(arguments: &Cancel) -> anyhow::Result<()> {
    let path = format!("/v1/jobs/{}/cancel", arguments.id);
    let job = block_on(async { arguments.server.client()?.post_json(&path, &json!({})).await })?;
    arguments.output.told(&job, || match job["status"].as_str() {
        Some("running") => format!("{} is asked to stop", arguments.id),
        status => format!("{} is {}", arguments.id, status.unwrap_or("over")),
    })
}
