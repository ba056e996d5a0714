//! `kincal copy-store`: from the embedded database to PostgreSQL, or back.

use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;
use crate::store::verify::{self, Options};
use crate::store::{Store, StoreLocation, audit, copy};
use serde_json::{Value, json};

/// Copy a whole database into an empty one, and check the copy as `verify-store` does. Stop all servers and workers first.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Source: a data directory, or postgres://….
    #[arg(
        long,
        env = "KINCAL_FROM",
        value_name = "DIR|URL",
        hide_env_values = true
    )]
    from: StoreLocation,
    /// Destination: a new data directory, or the URL of an empty PostgreSQL database.
    #[arg(
        long,
        env = "KINCAL_TO",
        value_name = "DIR|URL",
        hide_env_values = true
    )]
    to: StoreLocation,
    #[command(flatten)]
    output: Output,
}

/// Copies the database and checks the copy.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (from, to) = (arguments.from.clone(), arguments.to.clone());
    if from == to {
        return Err(Usage("--from and --to are the same database".into()).into());
    }
    if let StoreLocation::Sqlite { data_dir } = &from
        && !data_dir.is_dir()
    {
        return Err(Usage(format!(
            "--from {}: there is no such data directory",
            data_dir.display()
        ))
        .into());
    }
    block_on(async {
        // Opened in the same way as by a server: this migrates the schema, and refuses a data directory that is in use.
        let from = Store::open(from).await?;
        let to = Store::open(to).await?;
        let copied = copy::copy(&from, &to, |table| eprintln!("copying {table}")).await?;
        let checks = verify::verify(
            &to,
            &Options {
                known_head: None,
                is_served: false,
            },
        )
        .await?;
        let n_violations: i64 = checks.iter().map(|check| check.n_violations).sum();
        let head_from = audit::head(&from).await?.entry();
        let head = audit::head(&to).await?.entry();
        from.close().await;
        to.close().await;
        anyhow::ensure!(
            n_violations == 0,
            "the copy breaks {n_violations} promises; `kincal verify-store` on it says which"
        );
        anyhow::ensure!(
            head == head_from,
            "the copy's audit chain ends elsewhere: somebody wrote to the source meanwhile; copy again"
        );
        let tables: Vec<Value> = copied
            .iter()
            .map(|copied| json!({"table": copied.table, "n_rows": copied.n_rows}))
            .collect();
        let answer =
            json!({"tables": tables, "audit_head": {"seq": head.seq, "sha256": head.sha256}});
        arguments.output.print(&answer, || {
            let rows: String = copied
                .iter()
                .map(|copied| format!("{:>10} rows of {}\n", copied.n_rows, copied.table))
                .collect();
            format!("{rows}the copy keeps all promises; head of the audit chain: {head}")
        })
    })
}
