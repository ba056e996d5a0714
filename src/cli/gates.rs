//! `kincal gates`: checks the gates of a release, without releasing.

use super::remedy::in_commands;
use super::subject::OfParameterSet;
use super::terminal;
use super::terminal::{Output, plain};
use serde_json::Value;

/// `kincal gates`.
pub fn run(of: &OfParameterSet) -> anyhow::Result<()> {
    show(&of.get("/gates")?, &of.id, &of.output)
}

/// Prints the gates of a parameter set; an error if one would refuse its release.
pub fn show(found: &Value, id: &str, output: &Output) -> anyhow::Result<()> {
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
