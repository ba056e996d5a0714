//! `kincal backup`: a copy of the embedded database, checked.

use super::runtime::block_on;
use super::terminal::Output;
use crate::config::DatabaseConfig;
use crate::store::verify::{self, Options};
use crate::store::{Store, StoreLocation, audit, backup};
use serde_json::json;
use std::path::PathBuf;

/// Source and destination.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    database: DatabaseConfig,
    /// A new or empty directory. To restore, start a server with --data-dir on it.
    #[arg(value_name = "DIRECTORY")]
    to: PathBuf,
    #[command(flatten)]
    output: Output,
}

/// Copies the database and checks the copy.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    block_on(async {
        let store = Store::open_unmigrated(StoreLocation::from(&arguments.database)).await?;
        let written = backup::write(&store, &arguments.to).await;
        store.close().await;
        written?;
        let copy = Store::open_unmigrated(StoreLocation::Sqlite {
            data_dir: arguments.to.clone(),
        })
        .await?;
        // The default options assume that no server uses the database, which is true of a copy.
        let checks = verify::verify(&copy, &Options::default()).await?;
        let head = audit::head(&copy).await?;
        copy.close().await;
        let broken: Vec<&str> = checks
            .iter()
            .filter(|check| check.n_violations > 0)
            .map(|check| check.id)
            .collect();
        anyhow::ensure!(
            broken.is_empty(),
            "the copy breaks {}: look with `kincal verify-store --data-dir {}`",
            broken.join(", "),
            arguments.to.display()
        );
        let answer = json!({"directory": arguments.to, "audit_head": {"seq": head.seq, "sha256": head.sha256}});
        arguments.output.print(&answer, || {
            format!(
                "{}: every promise kept; head of the audit chain: {}:{}",
                arguments.to.display(),
                head.seq,
                head.sha256
            )
        })
    })
}
