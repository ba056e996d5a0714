//! The item that a command is about: a robot, a parameter set or a job of a server. Also the format of the output.

use super::client::{Client, ServerArguments};
use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;
use crate::wire::id::is_plausible;
use reqwest::Method;
use serde::Serialize;
use serde_json::Value;

/// Maximum number of parameter sets that a message names.
const MAX_NAMED: usize = 10;

/// A robot of a server.
#[derive(Debug, clap::Args)]
pub struct RobotArgument {
    #[command(flatten)]
    pub server: ServerArguments,
    /// The robot: its id, name or serial number.
    #[arg(value_name = "ROBOT")]
    pub robot: String,
    #[command(flatten)]
    pub output: Output,
}

/// Declares a command-line argument for an item of a server. An entry states the type's name, the part of the path between `/v1/` and the
/// id, and the help text.
macro_rules! item_of_a_server {
    ($(#[$about:meta])* $name:ident, $kind:tt, $help:tt) => {
        $(#[$about])*
        #[derive(Debug, clap::Args)]
        pub struct $name {
            #[command(flatten)]
            server: ServerArguments,
            #[doc = $help]
            #[arg(value_name = "ID")]
            pub id: String,
            #[command(flatten)]
            pub output: Output,
        }

        impl $name {
            /// Reads a path below the item.
            pub fn get(&self, below: &str) -> anyhow::Result<Value> {
                self.server.get(&item($kind, &self.id, below)?)
            }
        }
    };
}

item_of_a_server! {
    /// A parameter set of a server.
    ParameterSetIdArgument, "parameter-sets", "The parameter set, as `kincal params` lists it."
}

/// A parameter set of a server, by its id or by its robot.
#[derive(Debug, clap::Args)]
pub struct ParameterSetArgument {
    #[command(flatten)]
    pub server: ServerArguments,
    /// The parameter set, as `kincal params` lists it; or its robot (id, name or serial number), for its only candidate or its released set.
    #[arg(value_name = "ID|ROBOT")]
    pub named: String,
}

/// Which parameter set of a robot a command is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetOfRobot {
    /// The only candidate.
    Candidate,
    /// The released set.
    Active,
}

impl ParameterSetArgument {
    /// As [`parameter_set_id`].
    pub async fn id(&self, client: &Client, which: SetOfRobot) -> anyhow::Result<String> {
        parameter_set_id(client, &self.named, which).await
    }
}

/// Sends JSON to a path below the parameter set that a text names: by its own id, or by its robot for the released set.
pub fn post_to_parameter_set(
    server: &ServerArguments,
    named: &str,
    below: &str,
    body: &impl Serialize,
) -> anyhow::Result<Value> {
    block_on(async {
        let client = server.client()?;
        let id = parameter_set_id(&client, named, SetOfRobot::Active).await?;
        let path = item("parameter-sets", &id, below)?;
        client.send(Method::POST, &path, body).await
    })
}

/// The id of the parameter set that a text names: by its own id, or by its robot's id, name or serial number.
///
/// # Errors
/// [`Usage`] if a robot has no such set, or several candidates: a person chooses what is released.
async fn parameter_set_id(
    client: &Client,
    named: &str,
    which: SetOfRobot,
) -> anyhow::Result<String> {
    if named.starts_with("par_") {
        return Ok(checked(named)?.into());
    }
    let robot = client.robot_id(named).await?;
    let sets = format!("/v1/robots/{robot}/parameter-sets");
    if which == SetOfRobot::Active {
        let active = client.get(&format!("{sets}/active")).await?;
        return Ok(active["id"].as_str().unwrap_or_default().into());
    }
    let answer = client
        .get(&format!("{sets}?status=candidate&limit={MAX_NAMED}"))
        .await?;
    let items = answer["items"].as_array().into_iter().flatten();
    let ids: Vec<&str> = items.filter_map(|set| set["id"].as_str()).collect();
    match ids[..] {
        [id] => Ok(id.into()),
        [] => Err(Usage(format!(
            "robot {named:?} has no candidate; `kincal params --robot {named:?}` lists its parameter sets"
        ))
        .into()),
        _ => Err(Usage(format!(
            "robot {named:?} has several candidates; name one of them: {}",
            ids.join(", ")
        ))
        .into()),
    }
}
item_of_a_server! {
    /// A job of a server.
    JobArgument, "jobs", "The job, as `kincal jobs` lists it."
}

impl JobArgument {
    /// Sends JSON to a path below the job.
    pub fn post(&self, below: &str, body: &impl Serialize) -> anyhow::Result<Value> {
        self.server.post(&item("jobs", &self.id, below)?, body)
    }

    /// Reads a document below the job that is not JSON.
    pub fn read(&self, below: &str) -> anyhow::Result<Vec<u8>> {
        self.server.read(&item("jobs", &self.id, below)?)
    }
}

impl RobotArgument {
    /// The client, and the robot's path or one below it.
    pub async fn at(&self, below: &str) -> anyhow::Result<(Client, String)> {
        let client = self.server.client()?;
        let robot = client.robot_id(&self.robot).await?;
        Ok((client, format!("/v1/robots/{robot}{below}")))
    }

    /// Reads the robot, or what is below it.
    pub fn get(&self, below: &str) -> anyhow::Result<Value> {
        block_on(async {
            let (client, path) = self.at(below).await?;
            client.get(&path).await
        })
    }

    /// Sends JSON to a path below the robot.
    pub fn send(
        &self,
        method: Method,
        below: &str,
        body: &impl Serialize,
    ) -> anyhow::Result<Value> {
        block_on(async {
            let (client, path) = self.at(below).await?;
            client.send(method, &path, body).await
        })
    }
}

/// The path of an item, or of a document below it. Refuses a text that cannot be an id, because it could lead to another path.
pub fn item(kind: &str, id: &str, below: &str) -> Result<String, Usage> {
    Ok(format!("/v1/{kind}/{}{below}", checked(id)?))
}

/// Refuses what cannot be an id.
pub fn checked(id: &str) -> Result<&str, Usage> {
    match is_plausible(id) && !id.is_empty() {
        true => Ok(id),
        false => Err(Usage(format!(
            "{id:?} is not an id; ids have letters, digits and _ only, as kincal params and the other lists print them. If it is a robot, its parameter sets are listed by: kincal params --robot {id:?}"
        ))),
    }
}

/// The part of a path below a robot for a document that is kept under a name.
pub fn named(kind: &str, name: &str) -> anyhow::Result<String> {
    let mut url = reqwest::Url::parse("http://path/")?;
    if let Ok(mut parts) = url.path_segments_mut() {
        parts.extend([kind, name]);
    }
    Ok(url.path().to_owned())
}

/// A path with a query.
pub fn with_query(path: &str, query: &[(&str, String)]) -> anyhow::Result<String> {
    let url = reqwest::Url::parse_with_params("http://query/", query)?;
    Ok(format!("{path}?{}", url.query().unwrap_or_default()))
}
