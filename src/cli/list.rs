//! `kincal robots|sets|jobs|params`: lists what a server has, or shows one item.

use super::client::ServerArguments;
use super::robots_library::{self, LibraryCommand};
use super::runtime::block_on;
use super::terminal;
use super::terminal::{Output, in_commands, plain};
pub use super::text_table::columns;
use serde_json::Value;

/// Most rows of a list; the newest come first.
const MAX_ROWS: usize = 100;

/// A kind of item: its paths, and the fields that are the columns of its list.
struct Listing {
    /// Path of the list, for a robot's id.
    list: fn(&str) -> String,
    /// Path of one item, without its id.
    one: &'static str,
    columns: &'static [&'static str],
    /// Message for an empty list, with the next step.
    empty: &'static str,
}

const ROBOTS: Listing = Listing {
    list: |_| "/v1/robots".into(),
    one: "/v1/robots",
    columns: &["id", "name", "serial_number", "state"],
    empty: "there is no robot yet; next: kincal robots find TEXT, then kincal robots add",
};
const SETS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/measurement-sets"),
    one: "/v1/measurement-sets",
    columns: &[
        "id",
        "name",
        "frame",
        "n_points",
        "n_configurations",
        "n_targets",
        "created_at",
    ],
    empty: "this robot has no measurement set yet; next: kincal submit --robot ID SET.csv",
};
const JOBS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/jobs"),
    one: "/v1/jobs",
    columns: &[
        "id",
        "kind",
        "method",
        "status",
        "parameter_set_id",
        "created_at",
        "finished_at",
    ],
    empty: "this robot has no job yet; next: kincal submit --robot ID SET.csv --wait",
};
const PARAMETER_SETS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/parameter-sets"),
    one: "/v1/parameter-sets",
    columns: &["id", "status", "job_id", "created_at", "released_at"],
    empty: "nothing was identified for this robot yet; next: kincal submit --robot ID SET.csv --wait",
};

/// Robots of a server.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct RobotArguments {
    #[command(subcommand)]
    command: Option<RobotCommand>,
    #[command(flatten)]
    server: ServerArguments,
    /// Show this one in full.
    #[arg(value_name = "ID")]
    id: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// What else is done with robots.
#[derive(Debug, clap::Subcommand)]
enum RobotCommand {
    #[command(flatten)]
    Library(LibraryCommand),
}

/// A list of one robot, or one item by its own id.
#[derive(Debug, clap::Args)]
pub struct RobotListArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot: its id, name or serial number.
    #[arg(
        long,
        env = "KINCAL_ROBOT",
        value_name = "ROBOT",
        required_unless_present = "id"
    )]
    robot: Option<String>,
    /// Show this one in full.
    #[arg(value_name = "ID")]
    id: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// `kincal robots`.
pub fn robots(arguments: &RobotArguments) -> anyhow::Result<()> {
    if let Some(RobotCommand::Library(command)) = &arguments.command {
        return robots_library::run(command);
    }
    list_or_show(
        &arguments.server,
        &ROBOTS,
        "",
        arguments.id.as_deref(),
        &arguments.output,
    )
}

/// `kincal sets`.
pub fn sets(arguments: &RobotListArguments) -> anyhow::Result<()> {
    list_of_robot(arguments, &SETS)
}

/// `kincal jobs`.
pub fn jobs(arguments: &RobotListArguments) -> anyhow::Result<()> {
    list_of_robot(arguments, &JOBS)
}

/// Parameter sets of one robot, or one of them.
#[derive(Debug, clap::Args)]
pub struct ParameterSetArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot: its id, name or serial number.
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT", required_unless_present_any = ["id", "gates"])]
    robot: Option<String>,
    /// Show this one in full.
    #[arg(value_name = "ID")]
    id: Option<String>,
    /// Show what each gate of a release of this set would find now; exit code 1 if the release would be refused.
    #[arg(
        long, env = "KINCAL_GATES", requires = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    gates: bool,
    #[command(flatten)]
    output: Output,
}

/// `kincal params`.
pub fn parameter_sets(arguments: &ParameterSetArguments) -> anyhow::Result<()> {
    let ParameterSetArguments {
        server,
        robot,
        id,
        gates,
        output,
    } = arguments;
    match id {
        Some(id) if *gates => self::gates(server, id, output),
        _ => list_or_show(
            server,
            &PARAMETER_SETS,
            robot.as_deref().unwrap_or_default(),
            id.as_deref(),
            output,
        ),
    }
}

fn gates(server: &ServerArguments, id: &str, output: &Output) -> anyhow::Result<()> {
    block_on(async {
        let found = server
            .client()?
            .get(&format!("{}/{id}/gates", PARAMETER_SETS.one))
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
            (_, Value::Bool(true)) => "look",
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

fn list_of_robot(arguments: &RobotListArguments, kind: &Listing) -> anyhow::Result<()> {
    list_or_show(
        &arguments.server,
        kind,
        arguments.robot.as_deref().unwrap_or_default(),
        arguments.id.as_deref(),
        &arguments.output,
    )
}

fn list_or_show(
    server: &ServerArguments,
    kind: &Listing,
    robot: &str,
    id: Option<&str>,
    output: &Output,
) -> anyhow::Result<()> {
    block_on(async {
        let client = server.client()?;
        if let Some(id) = id {
            let one = client.get(&format!("{}/{id}", kind.one)).await?;
            say!("{}", serde_json::to_string_pretty(&one)?);
            return Ok(());
        }
        let robot = if robot.is_empty() {
            String::new()
        } else {
            client.robot_id(robot).await?
        };
        let page = client
            .get(&format!("{}?limit={MAX_ROWS}", (kind.list)(&robot)))
            .await?;
        if output.json {
            say!("{}", serde_json::to_string_pretty(&page)?);
            return Ok(());
        }
        let rows: Vec<Vec<String>> = page["items"]
            .as_array()
            .into_iter()
            .flatten()
            .map(|item| cells(item, kind.columns))
            .collect();
        if rows.is_empty() {
            say!("{}", kind.empty);
            return Ok(());
        }
        terminal::raw(columns(kind.columns, &rows));
        if !page["next_cursor"].is_null() {
            eprintln!("the newest {MAX_ROWS} are shown; there are more");
        }
        Ok(())
    })
}

/// An item's values in the order of the columns.
pub fn cells(item: &Value, columns: &[&str]) -> Vec<String> {
    let cell = |value: &Value| match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => plain(text).replace('\n', "\u{fffd}"),
        Value::Array(items) if items.iter().all(Value::is_string) => {
            let texts: Vec<&str> = items.iter().filter_map(Value::as_str).collect();
            plain(&texts.join(",")).replace('\n', "\u{fffd}")
        }
        other => other.to_string(),
    };
    columns.iter().map(|column| cell(&item[*column])).collect()
}
