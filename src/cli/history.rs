//! `kincal history|compare`: parameters over time, and the difference of two sets.

use super::subject::{ParameterSetIdArgument, RobotArgument, checked};
use super::terminal::cells;
use crate::wire::history::{CompareAnswer, HistoryAnswer, SessionTest};
use crate::wire::report_shape::ChangeReport;
use anyhow::Context;
use serde_json::{Value, json};

/// Maximum number of identifications in the list; the newest come first.
const MAX_ROWS: usize = 100;

/// Differences between two parameter sets of one robot.
#[derive(Debug, clap::Args)]
pub struct CompareArguments {
    #[command(flatten)]
    set: ParameterSetIdArgument,
    /// The parameter set to compare it with.
    #[arg(value_name = "WITH")]
    with: String,
}

/// `kincal history`.
pub fn history(of: &RobotArgument) -> anyhow::Result<()> {
    let answer = of.get(&format!("/history?limit={MAX_ROWS}"))?;
    let parsed: HistoryAnswer = serde_json::from_value(answer.clone())
        .context("the server's history is of another version of kincal")?;
    let names = [
        "parameter_set_id",
        "created_at",
        "status",
        "verify_rms_mm",
        "changed",
    ];
    let rows: Vec<Vec<String>> = parsed
        .items
        .iter()
        .map(|item| {
            let changed = in_words(&item.changed);
            let row = json!({"parameter_set_id": item.parameter_set_id, "created_at": item.created_at, "status": item.status,
                "verify_rms_mm": item.verify_rms_mm.map(|mm| format!("{mm:.4}")),
                "changed": if changed.is_empty() { Value::Null } else { json!(changed) }});
            cells(&row, &names)
        })
        .collect();
    let empty = "nothing was identified for this robot yet; next: kincal submit --robot ROBOT SET.csv --wait";
    of.output.table(&answer, &names, &rows, empty)
}

/// Significance level: below this probability the links count as different.
const SIGNIFICANCE_LEVEL: f64 = 0.01;

/// Text about the test of two sessions. Only a difference of the links is a change of the robot; the base changes with the instrument's position.
fn session_test_in_words(test: &SessionTest) -> String {
    let probability = match test.probability {
        p if p < 1e-4 => "below 0.0001".to_owned(),
        p => format!("{p:.4}"),
    };
    let verdict = match test.probability < SIGNIFICANCE_LEVEL {
        true => "the links differ beyond chance",
        false => "the links do not differ beyond chance",
    };
    let mut text = format!(
        "{verdict}: probability {probability} for an unchanged robot (chi-square {:.1}, {} combinations of parameters)",
        test.chi_square, test.n_combinations
    );
    if !test.changed.is_empty() {
        text += &format!("\n{}", in_words(&test.changed));
    }
    text
}

/// Text about changes: first the links, then base and reflector, which change whenever the instrument is moved.
fn in_words(changes: &[ChangeReport]) -> String {
    let is_of_robot = |change: &&ChangeReport| {
        !change.name.starts_with("base_") && !change.name.starts_with("target_")
    };
    let say = |changes: &[&ChangeReport]| {
        let one = |change: &&ChangeReport| {
            format!(
                "{} {:+.4} ({:.1} σ)",
                change.name, change.delta, change.sigmas
            )
        };
        changes.iter().map(one).collect::<Vec<_>>().join("; ")
    };
    let (own, placement): (Vec<&ChangeReport>, Vec<&ChangeReport>) =
        changes.iter().partition(is_of_robot);
    match (own.is_empty(), placement.is_empty()) {
        (_, true) => say(&own),
        (true, false) => format!("base and reflector: {}", say(&placement)),
        (false, false) => format!("{}; base and reflector: {}", say(&own), say(&placement)),
    }
}

/// `kincal compare`.
pub fn compare(arguments: &CompareArguments) -> anyhow::Result<()> {
    let (of, with) = (&arguments.set, checked(&arguments.with)?);
    let id = &of.id;
    let answer = of.get(&format!("/compare?with={with}"))?;
    let parsed: CompareAnswer = serde_json::from_value(answer.clone())
        .context("the server's comparison is of another version of kincal")?;
    of.output.print(&answer, || {
        let sessions = match &answer["sessions"] {
            Value::Null => "the sessions cannot be compared: both sets come from one upload, or one session is too small".to_owned(),
            _ => parsed.sessions.as_ref().map_or(String::new(), session_test_in_words),
        };
        format!(
            "the tool by {id} is {:.4} mm on average and at most {:.4} mm from the tool by {with}, over {} configurations\n{sessions}",
            parsed.mean_mm,
            parsed.max_mm,
            parsed.map.len()
        )
    })
}
