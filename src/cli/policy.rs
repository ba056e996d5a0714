//! `kincal policy`: shows or sets a robot's release policy.

use super::runtime::block_on;
use super::subject::RobotArgument;
use crate::wire::policy::{DecisionRule, PolicyBody};
use anyhow::Context;

/// A robot's release policy.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: PolicyCommand,
}

#[derive(Debug, clap::Subcommand)]
enum PolicyCommand {
    /// Show a robot's release policy.
    Show(RobotArgument),
    /// Set a robot's release policy; settings that are not given stay as they are.
    Set(SetArguments),
}

/// The robot and its policy.
#[derive(Debug, clap::Args)]
struct SetArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// Largest uncertainty and largest error on verify points, mm; `none` for no tolerance.
    #[arg(long, value_name = "MM", value_parser = tolerance)]
    tolerance_mm: Option<Tolerance>,
    /// How errors on verify points are compared with the tolerance: guarded_acceptance also takes their uncertainty into account.
    #[arg(long, value_name = "RULE")]
    decision_rule: Option<DecisionRule>,
    /// Whether another measuring session must have verified the set.
    #[arg(long, value_name = "true|false")]
    independent_session: Option<bool>,
    /// Whether the key that releases must differ from the keys that uploaded.
    #[arg(long, value_name = "true|false")]
    second_person: Option<bool>,
}

/// A tolerance, or none.
#[derive(Clone, Copy, Debug)]
struct Tolerance(Option<f64>);

fn tolerance(text: &str) -> Result<Tolerance, String> {
    if text == "none" {
        return Ok(Tolerance(None));
    }
    let mm = text.parse().map_err(|_| "a length in mm, or none")?;
    Ok(Tolerance(Some(mm)))
}

/// Shows the policy, or sets it.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (of, changes) = match &arguments.command {
        PolicyCommand::Show(of) => (of, None),
        PolicyCommand::Set(changes) => (&changes.robot, Some(changes)),
    };
    let policy = block_on(async {
        let (client, path) = of.at("/policy").await?;
        let now = client.get(&path).await?;
        let mut policy: PolicyBody = serde_json::from_value(now)
            .context("the server's policy is of another version of kincal")?;
        let Some(changes) = changes else {
            return Ok(policy);
        };
        if let Some(Tolerance(tolerance_mm)) = changes.tolerance_mm {
            policy.tolerance_mm = tolerance_mm;
        }
        if let Some(rule) = changes.decision_rule {
            policy.decision_rule = rule;
        }
        if let Some(required) = changes.independent_session {
            policy.independent_session_required = required;
        }
        if let Some(required) = changes.second_person {
            policy.second_person_required = required;
        }
        client.send(reqwest::Method::PUT, &path, &policy).await?;
        anyhow::Ok(policy)
    })?;
    of.output.print(&policy, || {
        let tolerance = policy
            .tolerance_mm
            .map_or("none".into(), |mm| format!("{mm} mm"));
        let yes = |required| if required { "yes" } else { "no" };
        format!(
            "tolerance: {tolerance}\ndecision rule: {}\nanother session must have verified the set: {}\nanother key must release it: {}",
            policy.decision_rule.as_str(),
            yes(policy.independent_session_required),
            yes(policy.second_person_required)
        )
    })
}
