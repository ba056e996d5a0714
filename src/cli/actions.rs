//! `kincal gates|release|withdraw|rollback|checked|cancel`: decisions of people about a parameter set, a robot or a job.

use super::remedy::in_commands;
use super::runtime::block_on;
use super::subject::{JobArgument, ParameterSetArgument, RobotArgument, SetOfRobot, item};
use super::terminal::{self, Output, plain};
use reqwest::Method;
use serde_json::{Value, json};

/// The parameter set, and the reason for the decision.
#[derive(Debug, clap::Args)]
pub struct DecisionArguments {
    #[command(flatten)]
    set: ParameterSetArgument,
    #[command(flatten)]
    output: Output,
    /// Reason; it is kept with the decision.
    #[arg(long, value_name = "TEXT")]
    reason: String,
}

/// The parameter set whose gates are shown.
#[derive(Debug, clap::Args)]
pub struct GateArguments {
    #[command(flatten)]
    set: ParameterSetArgument,
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

/// The robot, and the reason for the decision.
#[derive(Debug, clap::Args)]
pub struct RobotDecisionArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// Reason; it is kept with the decision.
    #[arg(long, value_name = "TEXT")]
    reason: String,
}

/// `kincal release`.
pub fn release(arguments: &ReleaseArguments) -> anyhow::Result<()> {
    let DecisionArguments {
        set,
        output,
        reason,
    } = &arguments.decision;
    let mut body = json!({"reason": reason});
    if let Some(change_reason) = &arguments.change_reason {
        body["change_reason"] = json!(change_reason);
    }
    let (id, was_released, set) = block_on(async {
        let client = set.server.client()?;
        let id = set.id(&client, SetOfRobot::Candidate).await?;
        // A key may release without being allowed to read; then the status before the release is unknown.
        let (was_released, set) = match client.get(&item("parameter-sets", &id, "")?).await {
            Ok(set) if set["status"] == "released" => (true, set),
            _ => {
                let path = item("parameter-sets", &id, "/release")?;
                (false, client.send(Method::POST, &path, &body).await?)
            }
        };
        anyhow::Ok((id, was_released, set))
    })?;
    output.print(&set, || match was_released {
        true => format!("{id} was released already; nothing changed"),
        false => format!("{id} is released: the cell gets it from now on"),
    })
}

/// `kincal withdraw`.
pub fn withdraw(arguments: &DecisionArguments) -> anyhow::Result<()> {
    let DecisionArguments {
        set,
        output,
        reason,
    } = arguments;
    let (id, set) = block_on(async {
        let client = set.server.client()?;
        let id = set.id(&client, SetOfRobot::Active).await?;
        let path = item("parameter-sets", &id, "/withdraw")?;
        let body = json!({"reason": reason});
        let set = client.send(Method::POST, &path, &body).await?;
        anyhow::Ok((id, set))
    })?;
    output.print(&set, || {
        format!("{id} is withdrawn; `kincal params` shows whether another one is active")
    })
}

/// `kincal checked`.
pub fn checked(arguments: &RobotDecisionArguments) -> anyhow::Result<()> {
    let of = &arguments.robot;
    let robot = of.send(
        Method::POST,
        "/checked",
        &json!({"reason": arguments.reason}),
    )?;
    of.output.print(&robot, || {
        format!(
            "{} is in order: no session is in doubt, and sets can be released",
            of.robot
        )
    })
}

/// `kincal rollback`.
pub fn roll_back(arguments: &RobotDecisionArguments) -> anyhow::Result<()> {
    let of = &arguments.robot;
    let body = json!({"reason": arguments.reason});
    let set = of.send(Method::POST, "/parameter-sets/rollback", &body)?;
    of.output.print(&set, || {
        format!(
            "{} is active again: the cell gets it from now on",
            set["id"].as_str().unwrap_or_default()
        )
    })
}

/// `kincal cancel`.
pub fn cancel(of: &JobArgument) -> anyhow::Result<()> {
    let job = of.post("/cancel", &json!({}))?;
    of.output.print(&job, || match job["status"].as_str() {
        Some("running") => format!("{} is asked to stop", of.id),
        status => format!("{} is {}", of.id, status.unwrap_or("over")),
    })
}

/// `kincal gates`.
pub fn gates(arguments: &GateArguments) -> anyhow::Result<()> {
    let set = &arguments.set;
    let (id, found) = block_on(async {
        let client = set.server.client()?;
        let id = set.id(&client, SetOfRobot::Candidate).await?;
        let found = client.get(&item("parameter-sets", &id, "/gates")?).await?;
        anyhow::Ok((id, found))
    })?;
    show_gates(&found, &id, &arguments.output)
}

/// Prints the gates of a parameter set; an error if one would refuse its release.
pub fn show_gates(found: &Value, id: &str, output: &Output) -> anyhow::Result<()> {
    match output.json {
        true => terminal::json(found)?,
        false => terminal::raw(gate_lines(found)),
    }
    if found["releasable"] != true {
        anyhow::bail!("a release of {id} would be refused");
    }
    Ok(())
}

fn gate_lines(found: &Value) -> String {
    let line = |gate: &Value| {
        let word = match (&gate["passed"], &gate["warning"]) {
            (Value::Bool(false), _) => "REFUSED",
            (_, Value::Bool(true)) => "warning",
            _ => "passed",
        };
        let text = |field: &str| gate[field].as_str().unwrap_or_default().to_owned();
        let (name, mut detail) = (text("gate"), text("detail"));
        if word == "REFUSED" {
            detail = in_commands(&name, &detail);
        }
        format!("{word:<8} {:<30} {}\n", plain(&name), plain(&detail))
    };
    found["gates"]
        .as_array()
        .into_iter()
        .flatten()
        .map(line)
        .collect()
}
