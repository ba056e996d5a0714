//! `kincal release|withdraw|rollback|checked|cancel`: decisions of people about a parameter set, a robot or a job.

use super::client::{Client, ServerArguments};
use super::runtime::block_on;
use super::terminal::Output;
use serde_json::{Value, json};

/// The parameter set, and the reason for the decision.
#[derive(Debug, clap::Args)]
struct DecisionArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The parameter set, as `kincal params` lists it.
    #[arg(value_name = "ID")]
    id: String,
    /// Reason; it is kept with the decision.
    #[arg(long, value_name = "TEXT")]
    reason: String,
    #[command(flatten)]
    output: Output,
}

/// Make a parameter set the robot's active one.
#[derive(Debug, clap::Args)]
pub struct ReleaseArguments {
    #[command(flatten)]
    decision: DecisionArguments,
    /// Why the parameters changed that much, if the gate change_plausible asks for it.
    #[arg(long, value_name = "TEXT")]
    change_reason: Option<String>,
}

/// Withdraw a parameter set: the cell no longer gets it.
#[derive(Debug, clap::Args)]
pub struct WithdrawArguments {
    #[command(flatten)]
    decision: DecisionArguments,
}

/// State why a robot in the state `check_robot` is in order.
#[derive(Debug, clap::Args)]
pub struct CheckedArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot: its id, name or serial number.
    #[arg(value_name = "ROBOT")]
    id: String,
    /// Reason; it is kept with the decision.
    #[arg(long, value_name = "TEXT")]
    reason: String,
    #[command(flatten)]
    output: Output,
}

/// Withdraw the active parameter set, and make the one that it superseded active again.
#[derive(Debug, clap::Args)]
pub struct RollbackArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot: its id, name or serial number.
    #[arg(value_name = "ROBOT")]
    robot: String,
    /// Reason; it is kept with the decision.
    #[arg(long, value_name = "TEXT")]
    reason: String,
    #[command(flatten)]
    output: Output,
}

/// Cancel a job.
#[derive(Debug, clap::Args)]
pub struct CancelArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The job, as `kincal jobs` lists it.
    #[arg(value_name = "ID")]
    id: String,
    #[command(flatten)]
    output: Output,
}

/// `kincal release`.
pub fn release(arguments: &ReleaseArguments) -> anyhow::Result<()> {
    let DecisionArguments {
        server,
        id,
        reason,
        output,
    } = &arguments.decision;
    let mut body = json!({"reason": reason});
    if let Some(change_reason) = &arguments.change_reason {
        body["change_reason"] = json!(change_reason);
    }
    let (was_released, set) = block_on(async {
        let client = server.client()?;
        // A key may release without being allowed to read; then the status before the release is unknown.
        match client.get(&format!("/v1/parameter-sets/{id}")).await {
            Ok(set) if set["status"] == "released" => Ok((true, set)),
            _ => Ok((false, post_decision(&client, id, "release", &body).await?)),
        }
    })?;
    output.print(&set, || match was_released {
        true => format!("{id} was released already; nothing changed"),
        false => format!("{id} is released: the cell gets it from now on"),
    })
}

/// `kincal withdraw`.
pub fn withdraw(arguments: &WithdrawArguments) -> anyhow::Result<()> {
    let DecisionArguments {
        server,
        id,
        reason,
        output,
    } = &arguments.decision;
    let set = block_on(async {
        post_decision(
            &server.client()?,
            id,
            "withdraw",
            &json!({"reason": reason}),
        )
        .await
    })?;
    output.print(&set, || {
        format!("{id} is withdrawn; `kincal params` shows whether another one is active")
    })
}

async fn post_decision(
    client: &Client,
    id: &str,
    action: &str,
    body: &Value,
) -> anyhow::Result<Value> {
    client
        .create(
            &format!("/v1/parameter-sets/{id}/{action}"),
            "application/json",
            serde_json::to_vec(body)?,
        )
        .await
}

/// `kincal checked`.
pub fn checked(arguments: &CheckedArguments) -> anyhow::Result<()> {
    let body = serde_json::to_vec(&json!({"reason": arguments.reason}))?;
    let robot = block_on(async {
        let client = arguments.server.client()?;
        let id = client.robot_id(&arguments.id).await?;
        let path = format!("/v1/robots/{id}/checked");
        client.create(&path, "application/json", body).await
    })?;
    arguments.output.print(&robot, || {
        format!(
            "{} is in order: no session is in doubt, and sets can be released",
            arguments.id
        )
    })
}

/// `kincal rollback`.
pub fn roll_back(arguments: &RollbackArguments) -> anyhow::Result<()> {
    let body = serde_json::to_vec(&json!({"reason": arguments.reason}))?;
    let set = block_on(async {
        let client = arguments.server.client()?;
        let robot = client.robot_id(&arguments.robot).await?;
        let path = format!("/v1/robots/{robot}/parameter-sets/rollback");
        client.create(&path, "application/json", body).await
    })?;
    arguments.output.print(&set, || {
        format!(
            "{} is active again: the cell gets it from now on",
            set["id"].as_str().unwrap_or_default()
        )
    })
}

/// `kincal cancel`.
pub fn cancel(arguments: &CancelArguments) -> anyhow::Result<()> {
    let path = format!("/v1/jobs/{}/cancel", arguments.id);
    let job = block_on(async {
        arguments
            .server
            .client()?
            .post_json(&path, &json!({}))
            .await
    })?;
    arguments
        .output
        .print(&job, || match job["status"].as_str() {
            Some("running") => format!("{} is asked to stop", arguments.id),
            status => format!("{} is {}", arguments.id, status.unwrap_or("over")),
        })
}
