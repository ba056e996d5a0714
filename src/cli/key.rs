//! `kincal key`: API keys. It may run while a server uses the database.

use super::runtime::block_on;
use super::terminal::{Output, cells};
use super::usage::Usage;
use crate::config::DatabaseConfig;
use crate::http::auth::new_key;
use crate::store::{
    self, ApiKeyRow, ListRequest, NewApiKey, Store, StoreLocation, api_keys, robots,
};
use crate::wire::key::Scope;
use crate::wire::time::rfc3339;
use anyhow::Context;
use clap::Subcommand;
use serde_json::{Value, json};
use std::io::Write;

/// Actor of these changes in the audit chain.
const COMMAND_LINE: &str = "command line";
/// Columns of the list.
const COLUMNS: [&str; 6] = ["id", "name", "scopes", "robots", "created_at", "revoked_at"];

/// Make, list and revoke keys.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Make a key; it is printed once, on standard output.
    Create {
        #[command(flatten)]
        database: DatabaseConfig,
        /// Holder of the key, e.g. cell-4.
        #[arg(long, value_parser = holder)]
        name: String,
        /// Permission of the key; may be given several times.
        #[arg(long = "scope", required = true, value_enum)]
        scopes: Vec<Scope>,
        /// Limit it to this robot; may be given several times.
        #[arg(long = "robot", value_name = "ID")]
        robots: Vec<String>,
        #[command(flatten)]
        output: Output,
    },
    /// List all keys, newest first; the secrets are not stored.
    List {
        #[command(flatten)]
        database: DatabaseConfig,
        #[command(flatten)]
        output: Output,
    },
    /// Revoke a key by its id, or every key with a name.
    Revoke {
        #[command(flatten)]
        database: DatabaseConfig,
        /// Id of the key, as `kincal key list` shows it.
        #[arg(conflicts_with = "name")]
        id: Option<String>,
        /// Name of the keys.
        #[arg(long)]
        name: Option<String>,
        #[command(flatten)]
        output: Output,
    },
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    block_on(async {
        match &arguments.action {
            Action::Create { database, name, scopes, robots, output } => create(&open(database).await?, name, scopes, robots, output).await,
            Action::List { database, output } => list(&open_unmigrated(database).await?, output).await,
            Action::Revoke { id: None, name: None, .. } => {
                Err(Usage("say which: the ID of a key, as `kincal key list` shows it, or --name NAME for every key of that name".into())
                    .into())
            }
            Action::Revoke { database, id, name, output } => {
                revoke(&open_unmigrated(database).await?, id.as_deref(), name.as_deref(), output).await
            }
        }
    })
}

async fn open(database: &DatabaseConfig) -> anyhow::Result<Store> {
    Ok(Store::open_for_command(StoreLocation::from(database)).await?)
}

/// Opens an existing database. With a wrong --data-dir it fails, and creates no database.
async fn open_unmigrated(database: &DatabaseConfig) -> anyhow::Result<Store> {
    Ok(Store::open_unmigrated(StoreLocation::from(database)).await?)
}

/// Parses the holder of a key.
fn holder(text: &str) -> Result<String, String> {
    if text.trim().is_empty() {
        Err("say whose key it is, e.g. cell-4".into())
    } else {
        Ok(text.into())
    }
}

async fn create(
    store: &Store,
    name: &str,
    scopes: &[Scope],
    robot_ids: &[String],
    output: &Output,
) -> anyhow::Result<()> {
    for id in robot_ids {
        match robots::get(store, id).await {
            Err(store::Error::NotFound) => {
                let text = format!("there is no robot {id:?}; `GET /v1/robots` lists them");
                return Err(Usage(text).into());
            }
            found => drop(found?),
        }
    }
    let names: Vec<&str> = scopes.iter().map(|scope| scope.as_str()).collect();
    let key = new_key()?;
    let robots_json = (!robot_ids.is_empty())
        .then(|| serde_json::to_string(robot_ids))
        .transpose()?;
    let new = NewApiKey {
        name: name.into(),
        key_sha256: key.sha256,
        scopes_json: serde_json::to_string(scopes)?,
        robots_json,
    };
    let mut tx = store.begin().await?;
    tx.act_as(COMMAND_LINE);
    let row = api_keys::insert(&mut tx, &new).await?;
    tx.commit().await?;
    let mut shown = key.text.clone();
    if output.json {
        let mut made = key_json(&row)?;
        made["key"] = key.text.into();
        shown = serde_json::to_string_pretty(&made)?;
    } else {
        eprintln!(
            "Key {} for {name:?} with {}. It is shown only now; send it as `Authorization: Bearer KEY`:",
            row.id,
            names.join(", ")
        );
    }
    // The key cannot be shown again, so a failed write is an error.
    writeln!(std::io::stdout().lock(), "{shown}")
        .with_context(|| format!("key {} was made but could not be shown: revoke it", row.id))
}

async fn all(store: &Store) -> anyhow::Result<Vec<ApiKeyRow>> {
    let mut rows = Vec::new();
    let mut request = ListRequest::all();
    loop {
        let page = api_keys::list(store, &request).await?;
        rows.extend(page.items);
        match page.next_cursor {
            Some(cursor) => request.cursor = Some(cursor),
            None => return Ok(rows),
        }
    }
}

fn key_json(row: &ApiKeyRow) -> anyhow::Result<Value> {
    let robots: Option<Value> = row
        .robots_json
        .as_deref()
        .map(serde_json::from_str)
        .transpose()?;
    Ok(json!({
        "id": row.id,
        "name": row.name,
        "scopes": serde_json::from_str::<Value>(&row.scopes_json)?,
        "robots": robots,
        "created_at": rfc3339(row.created_at_ms),
        "revoked_at": row.revoked_at_ms.map(rfc3339),
    }))
}

async fn list(store: &Store, output: &Output) -> anyhow::Result<()> {
    let rows = all(store).await?;
    let items = rows
        .iter()
        .map(key_json)
        .collect::<anyhow::Result<Vec<Value>>>()?;
    let answer = json!({"items": items});
    let everywhere = |mut item: Value| {
        if item["robots"].is_null() {
            item["robots"] = "all".into();
        }
        cells(&item, &COLUMNS)
    };
    let rows: Vec<Vec<String>> = items.into_iter().map(everywhere).collect();
    let empty = "there is no key yet; next: kincal key create --name cell-4 --scope read";
    output.table(&answer, &COLUMNS, &rows, empty)
}

async fn revoke(
    store: &Store,
    id: Option<&str>,
    name: Option<&str>,
    output: &Output,
) -> anyhow::Result<()> {
    let matches = |row: &ApiKeyRow| {
        row.revoked_at_ms.is_none()
            && (Some(row.id.as_str()) == id || Some(row.name.as_str()) == name)
    };
    let rows: Vec<ApiKeyRow> = all(store).await?.into_iter().filter(matches).collect();
    if rows.is_empty() {
        anyhow::bail!("no key in force has this id or name; `kincal key list` shows them");
    }
    let mut tx = store.begin().await?;
    tx.act_as(COMMAND_LINE);
    for row in &rows {
        api_keys::revoke(&mut tx, &row.id).await?;
    }
    tx.commit().await?;
    let revoked: Vec<Value> = rows
        .iter()
        .map(|row| json!({"id": row.id, "name": row.name}))
        .collect();
    output.print(&json!({"revoked": revoked}), || {
        let lines: Vec<String> = rows
            .iter()
            .map(|row| format!("revoked {} ({:?})", row.id, row.name))
            .collect();
        lines.join("\n")
    })
}
