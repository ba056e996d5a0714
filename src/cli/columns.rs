//! `kincal columns`: previews how a file would be read, and keeps mappings of columns with a robot.

use super::column_options::ColumnOptions;
use super::files;
use super::measured::{TableOptions, read_measurement_files, unread_in_words};
use super::runtime::block_on;
use super::subject::{RobotArgument, named, with_query};
use super::terminal::{Output, columns, items, plain};
use super::usage::Usage;
use crate::wire::issue::Issue;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Maximum number of mappings in the list.
const MAX_ROWS: usize = 100;

/// Mappings of the columns of a robot's files.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: ColumnsCommand,
}

#[derive(Debug, clap::Subcommand)]
enum ColumnsCommand {
    /// List the mappings that are kept with a robot.
    List(RobotArgument),
    /// Show a mapping.
    Show(ShowArguments),
    /// Keep a mapping under a name, for `kincal submit --kept NAME`.
    Keep(Box<KeepArguments>),
    /// Preview how a file, or two files, would be read; nothing is stored.
    Preview(Box<PreviewArguments>),
}

/// The robot and a mapping's name.
#[derive(Debug, clap::Args)]
struct ShowArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// The mapping's name.
    #[arg(value_name = "NAME")]
    name: String,
}

/// A mapping to keep.
#[derive(Debug, clap::Args)]
struct KeepArguments {
    #[command(flatten)]
    shown: ShowArguments,
    #[command(flatten)]
    columns: ColumnOptions,
}

/// Files to look at.
#[derive(Debug, clap::Args)]
struct PreviewArguments {
    #[command(flatten)]
    robot: RobotArgument,
    /// The set's file, or the robot's file if there are two; `-` reads the standard input.
    #[arg(value_name = "SET.csv")]
    set: PathBuf,
    #[command(flatten)]
    table: TableOptions,
}

/// Runs one of the commands.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.command {
        ColumnsCommand::List(arguments) => list(arguments),
        ColumnsCommand::Show(arguments) => {
            let found = arguments.robot.get(&named("columns", &arguments.name)?)?;
            print(&arguments.robot.output, &found)
        }
        ColumnsCommand::Keep(arguments) => keep(arguments),
        ColumnsCommand::Preview(arguments) => preview(arguments),
    }
}

/// Prints a mapping. Without `--json` this is the JSON that `--columns FILE` reads; with `--json` it is the server's whole answer.
fn print(output: &Output, found: &Value) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(&found["columns"])?;
    output.print(found, || plain(&text))
}

fn list(of: &RobotArgument) -> anyhow::Result<()> {
    let answer = of.get(&format!("/columns?limit={MAX_ROWS}"))?;
    let row = |item: &Value| {
        let text = |field: &str| plain(item[field].as_str().unwrap_or_default());
        vec![
            text("name"),
            text("created_at"),
            plain(&item["columns"].to_string()),
        ]
    };
    let rows: Vec<Vec<String>> = items(&answer).map(row).collect();
    let empty = "no mapping is kept with this robot; next: kincal columns keep ROBOT NAME --joint-unit deg …";
    let names = ["name", "created_at", "columns"];
    of.output.table(&answer, &names, &rows, empty)
}

fn keep(arguments: &KeepArguments) -> anyhow::Result<()> {
    let body = arguments.columns.body()?;
    if body.0.is_empty() {
        let text = "nothing to keep: say what the columns mean, by --joint-unit, --position-unit, --column MEANING=COLUMN or --columns FILE";
        return Err(Usage(text.into()).into());
    }
    let ShowArguments { robot, name } = &arguments.shown;
    let kept = robot.send(reqwest::Method::PUT, &named("columns", name)?, &body)?;
    robot.output.print(&kept, || {
        format!("{name} is kept; next: kincal submit --robot ROBOT SET.csv --kept {name:?}")
    })
}

fn preview(arguments: &PreviewArguments) -> anyhow::Result<()> {
    let files = read_measurement_files(&arguments.set, &arguments.table)?;
    let mut query = vec![];
    query.extend(files.decimal.map(|_| ("decimal", "comma".to_owned())));
    if !files.columns.0.is_empty() {
        query.push(("columns", serde_json::to_string(&files.columns)?));
    }
    let below = with_query("/measurement-sets/preview", &query)?;
    let answer = block_on(async {
        let (client, path) = arguments.robot.at(&below).await?;
        client.post(&path, &files.content_type, files.bytes).await
    })?;
    arguments.robot.output.print(&answer, || shown(&answer))
}

/// Number of rows of a file that are shown.
const ROWS_SHOWN: usize = 5;

fn shown(answer: &Value) -> String {
    let mut text = String::new();
    for file in answer["files"].as_array().into_iter().flatten() {
        let cells = |row: &Value| -> Vec<String> {
            let cells = row.as_array().into_iter().flatten();
            cells
                .map(|cell| plain(cell.as_str().unwrap_or_default()))
                .collect()
        };
        let width = cells(&file["header"]).len();
        let cells = |row: &Value| {
            let mut cells = cells(row);
            cells.resize(width, String::new());
            cells
        };
        let header = cells(&file["header"]);
        let used = file["understood"]["columns"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        let means = |number: usize| {
            let column = used.iter().find(|column| column["number"] == json!(number));
            column.map_or("–".into(), |column| match column["unit"].as_str() {
                Some(unit) => format!("{}_{unit}", column["means"].as_str().unwrap_or_default()),
                None => column["means"].as_str().unwrap_or_default().to_owned(),
            })
        };
        let meanings: Vec<String> = (1..=header.len()).map(means).collect();
        let names: Vec<&str> = header.iter().map(String::as_str).collect();
        let rows = file["rows"]
            .as_array()
            .into_iter()
            .flatten()
            .take(ROWS_SHOWN)
            .map(cells);
        let rows: Vec<Vec<String>> = std::iter::once(meanings).chain(rows).collect();
        text += &format!(
            "{} file\n{}\n",
            file["part"].as_str().unwrap_or_default(),
            columns(&names, &rows)
        );
        let understood = serde_json::from_value(file["understood"].clone()).ok();
        if let Some(line) = understood.as_ref().and_then(unread_in_words) {
            text += &format!("{line}\n");
        }
    }
    let errors: Vec<Issue> = serde_json::from_value(answer["errors"].clone()).unwrap_or_default();
    match errors.is_empty() {
        true => text += &format!("it can be read: {} points", answer["n_points"]),
        false => text += &format!("it cannot be read yet:{}", files::issues_in_words(&errors)),
    }
    text
}
