//! `kincal worker`: a node that only computes. `kincal migrate`: updates the schema.

use super::runtime::block_on;
use super::serve::stop_signal;
use super::terminal::Output;
use super::usage::Usage;
use crate::config::{DatabaseConfig, STOP_WITHIN, WorkerConfig, n_workers};
use crate::http::server::rules;
use crate::jobs::{JobSignals, WorkerPool, backfill, execution};
use crate::store::{Store, StoreLocation};
use crate::telemetry;
use std::time::Duration;

/// Computes until a stop signal.
pub fn run(config: &WorkerConfig) -> anyhow::Result<()> {
    config.check().map_err(|error| Usage(error.to_string()))?;
    telemetry::start();
    block_on(async {
        // Installed before the first job: the default action of a signal would kill the process.
        let stop_signal = stop_signal()?;
        let store = Store::open(StoreLocation::from(&config.database)).await?;
        backfill::backfill_missing(&store).await?;
        let queue = config.queue;
        let pool = WorkerPool::start(
            store.clone(),
            execution::compute,
            n_workers(config.workers),
            rules(&queue),
            JobSignals::default(),
        );
        say!(
            "kincal computing with {} workers",
            n_workers(config.workers)
        );
        stop_signal.await;
        tracing::info!("stopping: handing running jobs back");
        pool.shutdown(STOP_WITHIN).await;
        let _ = tokio::time::timeout(Duration::from_secs(1), store.close()).await;
        Ok(())
    })
}

/// Bring the database's schema up to date, and print its version. `serve` and `worker` do the same when they start. Several processes may do so at
/// the same time.
#[derive(Debug, clap::Args)]
pub struct MigrateArguments {
    #[command(flatten)]
    database: DatabaseConfig,
    #[command(flatten)]
    output: Output,
}

/// Updates the schema and prints its version.
pub fn migrate(arguments: &MigrateArguments) -> anyhow::Result<()> {
    block_on(async {
        let store = Store::open(StoreLocation::from(&arguments.database)).await?;
        backfill::backfill_missing(&store).await?;
        let version = store.schema_version().await?;
        store.close().await;
        arguments
            .output
            .print(&serde_json::json!({"schema_version": version}), || {
                format!("the schema is at version {version}")
            })
    })
}
