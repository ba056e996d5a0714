//! `kincal robots|sets|jobs|params|networks`: lists what a server has, or shows one item.

use super::actions::show_gates;
use super::client::{Client, ServerArguments};
use super::runtime::block_on;
use super::subject::{item, with_query};
use super::terminal::{self, Output, cells, items};
use crate::wire::overview::Need;
use crate::wire::page::{ArchivedFilter, Sort};
use anyhow::Context;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Maximum number of rows of a list; the newest come first.
const MAX_ROWS: usize = 100;

/// A kind of item: its paths, and the fields that are the columns of its list.
struct Listing {
    /// Path of the list, for a robot's id.
    list: fn(&str) -> String,
    /// The part of the path of one item between `/v1/` and its id.
    one: &'static str,
    columns: &'static [&'static str],
    /// Message for an empty list, with the next step.
    empty: &'static str,
}

const ROBOTS: Listing = Listing {
    list: |_| "/v1/robots".into(),
    one: "robots",
    columns: &["id", "name", "serial_number", "state"],
    empty: "there is no robot yet; next: kincal robots find TEXT, then kincal robots add",
};
const SETS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/measurement-sets"),
    one: "measurement-sets",
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
    one: "jobs",
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
const ALL_JOBS: Listing = Listing {
    list: |_| "/v1/jobs".into(),
    one: "jobs",
    columns: &[
        "id",
        "robot_id",
        "kind",
        "method",
        "status",
        "parameter_set_id",
        "created_at",
        "finished_at",
    ],
    empty: "there is no job yet; next: kincal submit --robot ID SET.csv --wait",
};
const NETWORKS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/networks"),
    one: "networks",
    columns: &["id", "kind", "job_id", "model", "preset", "created_at"],
    empty: "this robot has no network yet; next: kincal submit --robot ID SET.csv --method pso --wait",
};
const PARAMETER_SETS: Listing = Listing {
    list: |robot| format!("/v1/robots/{robot}/parameter-sets"),
    one: "parameter-sets",
    columns: &["id", "status", "job_id", "created_at", "released_at"],
    empty: "nothing was identified for this robot yet; next: kincal submit --robot ID SET.csv --wait",
};

/// Filter and order of a list.
#[derive(Debug, clap::Args)]
struct ListOptions {
    /// List the items in use (false), the archived ones (true), or all.
    #[arg(
        long,
        env = "KINCAL_ARCHIVED",
        value_enum,
        default_value = "false",
        value_name = "false|true|all",
        hide_possible_values = true
    )]
    archived: ArchivedFilter,
    /// Order: created_at or name; with a leading - in descending order [default: -created_at].
    #[arg(
        long,
        env = "KINCAL_SORT",
        value_enum,
        value_name = "ORDER",
        allow_hyphen_values = true,
        hide_possible_values = true
    )]
    sort: Option<Sort>,
    #[command(flatten)]
    output: Output,
}

impl ListOptions {
    fn query(&self) -> Vec<(&'static str, String)> {
        let mut query = Vec::new();
        if self.archived != ArchivedFilter::False {
            query.push(("archived", self.archived.as_str().to_owned()));
        }
        if let Some(sort) = self.sort {
            query.push(("sort", name_of(sort)));
        }
        query
    }
}

/// Name of a value on the command line. The query uses the same name.
fn name_of(value: impl clap::ValueEnum) -> String {
    value
        .to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned())
}

/// The items of a robot, or one of them.
#[derive(Debug, clap::Args)]
struct RobotItemArguments {
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
    options: ListOptions,
}

impl RobotItemArguments {
    fn list_or_show(
        &self,
        kind: &Listing,
        filters: &[(&'static str, &Option<String>)],
    ) -> anyhow::Result<()> {
        let (robot, id) = (self.robot.as_ref(), self.id.as_ref());
        list_or_show(kind, &self.server, robot, id, &self.options, filters)
    }
}

/// Robots of a server.
#[derive(Debug, clap::Args)]
pub struct RobotArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Show this one in full: its id, name or serial number.
    #[arg(value_name = "ROBOT")]
    pub(super) id: Option<String>,
    /// Only robots whose name or serial number contains this text.
    #[arg(long, env = "KINCAL_SEARCH", value_name = "TEXT")]
    search: Option<String>,
    /// List all robots with what each needs, and why; the most urgent first.
    #[arg(
        long, env = "KINCAL_NEEDS", conflicts_with_all = ["id", "sort"], value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    needs: bool,
    #[command(flatten)]
    options: ListOptions,
}

/// A list of one robot, or one item by its own id.
#[derive(Debug, clap::Args)]
pub struct SetArguments {
    #[command(flatten)]
    of: RobotItemArguments,
    /// Print the uploaded file, byte for byte.
    #[arg(
        long, env = "KINCAL_POINTS", requires = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    points: bool,
    /// With --points: print the points as they were read, in one table, instead of the uploaded file.
    #[arg(
        long, env = "KINCAL_CSV", requires = "points", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    csv: bool,
    /// Only sets whose name contains this text.
    #[arg(long, env = "KINCAL_SEARCH", value_name = "TEXT")]
    search: Option<String>,
}

/// Jobs of all robots or of one, or one job by its id.
#[derive(Debug, clap::Args)]
pub struct JobArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The robot: its id, name or serial number [default: all that the key may see].
    #[arg(long, env = "KINCAL_ROBOT", value_name = "ROBOT")]
    robot: Option<String>,
    /// Show this one in full.
    #[arg(value_name = "ID")]
    id: Option<String>,
    /// Show the smallest cost at each iteration.
    #[arg(
        long, env = "KINCAL_CONVERGENCE", requires = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    convergence: bool,
    /// Only jobs with this status: queued, running, succeeded, failed or cancelled.
    #[arg(long, env = "KINCAL_STATUS", value_name = "STATUS")]
    status: Option<String>,
    /// Only jobs of this kind: identify, verify or check.
    #[arg(long, env = "KINCAL_KIND", value_name = "KIND")]
    kind: Option<String>,
    #[command(flatten)]
    options: ListOptions,
}

/// Networks of one robot, or one of them.
#[derive(Debug, clap::Args)]
pub struct NetworkArguments {
    #[command(flatten)]
    of: RobotItemArguments,
    /// Write its weights (safetensors) into this file.
    #[arg(long, env = "KINCAL_WEIGHTS", value_name = "FILE", requires = "id")]
    weights: Option<PathBuf>,
}

/// Columns of the list of needs.
const NEED_COLUMNS: [&str; 4] = ["robot_id", "name", "need", "reason"];
/// Maximum number of pages of the list of needs.
const MAX_PAGES: usize = 100;

/// Lists what each robot needs.
fn needs(arguments: &RobotArguments) -> anyhow::Result<()> {
    let mut query = arguments.options.query();
    query.extend(arguments.search.clone().map(|text| ("search", text)));
    query.push(("limit", MAX_ROWS.to_string()));
    let mut robots: Vec<Value> = block_on(async {
        let client = arguments.server.client()?;
        let (mut robots, mut cursor) = (Vec::new(), None);
        for _ in 0..MAX_PAGES {
            let mut query = query.clone();
            query.extend(cursor.map(|cursor| ("cursor", cursor)));
            let page = client.get(&with_query("/v1/overview", &query)?).await?;
            robots.extend(items(&page).cloned());
            cursor = page["next_cursor"].as_str().map(str::to_owned);
            if cursor.is_none() {
                break;
            }
        }
        anyhow::Ok(robots)
    })?;
    // needs are ordered by urgency
    robots.sort_by_key(|robot| Need::deserialize(&robot["need"]).ok());
    let rows: Vec<_> = robots.iter().map(|r| cells(r, &NEED_COLUMNS)).collect();
    let output = &arguments.options.output;
    let answer = json!({"items": robots});
    output.table(&answer, &NEED_COLUMNS, &rows, ROBOTS.empty)
}

/// `kincal robots`.
pub fn robots(arguments: &RobotArguments) -> anyhow::Result<()> {
    if arguments.needs {
        return needs(arguments);
    }
    let filters = [("search", &arguments.search)];
    list_or_show(
        &ROBOTS,
        &arguments.server,
        None,
        arguments.id.as_ref(),
        &arguments.options,
        &filters,
    )
}

/// `kincal sets`.
pub fn sets(arguments: &SetArguments) -> anyhow::Result<()> {
    let of = &arguments.of;
    if let (Some(id), true) = (&of.id, arguments.points) {
        let what = match arguments.csv {
            true => "/points?format=csv",
            false => "/points",
        };
        terminal::raw(of.server.read(&item(SETS.one, id, what)?)?);
        return Ok(());
    }
    of.list_or_show(&SETS, &[("search", &arguments.search)])
}

/// `kincal jobs`.
pub fn jobs(arguments: &JobArguments) -> anyhow::Result<()> {
    if let (Some(id), true) = (&arguments.id, arguments.convergence) {
        let path = item(JOBS.one, id, "/convergence")?;
        let curve = arguments.server.get(&path)?;
        return terminal::json(&curve);
    }
    let filters = [("status", &arguments.status), ("kind", &arguments.kind)];
    let (robot, id) = (arguments.robot.as_ref(), arguments.id.as_ref());
    let kind = robot.map_or(&ALL_JOBS, |_| &JOBS);
    list_or_show(
        kind,
        &arguments.server,
        robot,
        id,
        &arguments.options,
        &filters,
    )
}

/// `kincal networks`.
pub fn networks(arguments: &NetworkArguments) -> anyhow::Result<()> {
    let of = &arguments.of;
    if let (Some(id), Some(file)) = (&of.id, &arguments.weights) {
        let weights = of.server.read(&item(NETWORKS.one, id, "/weights")?)?;
        return std::fs::write(file, weights)
            .with_context(|| format!("cannot write {}", file.display()));
    }
    of.list_or_show(&NETWORKS, &[])
}

/// Parameter sets of one robot, or one of them.
#[derive(Debug, clap::Args)]
pub struct ParameterSetArguments {
    #[command(flatten)]
    of: RobotItemArguments,
    /// Check the gates of a release of this set, without releasing it; exit code 1 if the release would be refused.
    #[arg(
        long, env = "KINCAL_GATES", requires = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    gates: bool,
    /// Show the robot's active set.
    #[arg(
        long, env = "KINCAL_ACTIVE", conflicts_with = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    active: bool,
    /// Print the identified parameters alone, exactly as the set's sha256 covers them.
    #[arg(
        long, env = "KINCAL_CONTENT", requires = "id", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue
    )]
    content: bool,
    /// Only sets with this status: candidate, released, superseded or withdrawn.
    #[arg(long, env = "KINCAL_STATUS", value_name = "STATUS")]
    status: Option<String>,
}

/// `kincal params`.
pub fn parameter_sets(arguments: &ParameterSetArguments) -> anyhow::Result<()> {
    let of = &arguments.of;
    if let Some(id) = &of.id {
        if arguments.gates {
            let path = item(PARAMETER_SETS.one, id, "/gates")?;
            return show_gates(&of.server.get(&path)?, id, &of.options.output);
        }
        if arguments.content {
            let path = item(PARAMETER_SETS.one, id, "/content")?;
            terminal::raw(of.server.read(&path)?);
            return Ok(());
        }
    }
    if arguments.active {
        let set = block_on(async {
            let client = of.server.client()?;
            let robot = client
                .robot_id(of.robot.as_deref().unwrap_or_default())
                .await?;
            client
                .get(&format!("/v1/robots/{robot}/parameter-sets/active"))
                .await
        })?;
        return terminal::json(&set);
    }
    of.list_or_show(&PARAMETER_SETS, &[("status", &arguments.status)])
}

/// Lists the items of a robot (its id, name or serial number) or of all robots, or shows the one with this id.
fn list_or_show(
    kind: &Listing,
    server: &ServerArguments,
    robot: Option<&String>,
    id: Option<&String>,
    options: &ListOptions,
    filters: &[(&'static str, &Option<String>)],
) -> anyhow::Result<()> {
    let mut query = options.query();
    query.extend(
        filters
            .iter()
            .filter_map(|(name, text)| Some((*name, (*text).clone()?))),
    );
    block_on(async {
        let client = server.client()?;
        if let Some(named) = id {
            let id = match kind.one == ROBOTS.one {
                true => client.robot_id(named).await?,
                false => named.clone(),
            };
            return terminal::json(&client.get(&item(kind.one, &id, "")?).await?);
        }
        let robot = match robot {
            Some(robot) => client.robot_id(robot).await?,
            None => String::new(),
        };
        let is_filtered = !query.is_empty();
        query.push(("limit", MAX_ROWS.to_string()));
        let path = (kind.list)(&robot);
        let page = client.get(&with_query(&path, &query)?).await?;
        let rows: Vec<Vec<String>> = items(&page).map(|item| cells(item, kind.columns)).collect();
        let output = &options.output;
        let n_archived = match options.archived {
            ArchivedFilter::False if rows.is_empty() && !output.json => {
                n_archived(&client, &path, query).await?
            }
            _ => 0,
        };
        let empty = empty_list_in_words(kind.empty, is_filtered, n_archived);
        output.table(&page, kind.columns, &rows, &empty)?;
        if !page["next_cursor"].is_null() && !output.json {
            eprintln!(
                "the first {MAX_ROWS} of {} are shown: choose by the filters that --help lists",
                page["total"]
            );
        }
        Ok(())
    })
}

/// Number of archived items that match the other filters of a list.
async fn n_archived(
    client: &Client,
    path: &str,
    mut query: Vec<(&'static str, String)>,
) -> anyhow::Result<u64> {
    query.push(("archived", ArchivedFilter::True.as_str().to_owned()));
    let page: Value = client.get(&with_query(path, &query)?).await?;
    Ok(page["total"].as_u64().unwrap_or(0))
}

/// Message for a list without rows.
fn empty_list_in_words(empty: &str, is_filtered: bool, n_archived: u64) -> String {
    match (is_filtered, n_archived) {
        (true, 0) => "no item matches these filters".into(),
        (false, 0) => empty.into(),
        (_, n) => format!("nothing in use is listed, but {n} archived: --archived true lists them"),
    }
}
