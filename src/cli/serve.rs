//! `kincal serve`; `kincal worker`, a node that only computes; `kincal migrate`, which updates the schema.

use super::runtime::block_on;
use super::terminal::Output;
use super::usage::Usage;
use crate::config::{DatabaseConfig, STOP_WITHIN, ServeConfig, WorkerConfig, n_workers};
use crate::http::server::{self, RunningServer, attempt_limits};
use crate::jobs::{JobSignals, WorkerPool, backfill, execution};
use crate::store::{ListRequest, Store, StoreLocation, api_keys};
use crate::telemetry;
use std::io::Write;
use std::time::Duration;

/// Serves until a stop signal.
pub fn run(config: &ServeConfig) -> anyhow::Result<()> {
    config.check().map_err(|error| Usage(error.to_string()))?;
    telemetry::start();
    block_on(async {
        // Installed before the first request: the default action of a signal would kill the process.
        let stop_signal = stop_signal()?;
        let server = server::start(config).await?;
        announce(config, &server).await?;
        stop_signal.await;
        tracing::info!("stopping: finishing requests, handing running jobs back");
        server.shutdown().await;
        Ok(())
    })
}

async fn announce(config: &ServeConfig, server: &RunningServer) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "kincal listening on {}", server.url())?;
    out.flush()?;
    drop(out);
    let keys = api_keys::list(&server.store, &ListRequest::all()).await?;
    if !config.no_auth && keys.total == 0 {
        let store = match &config.database.database_url {
            // The URL itself is not printed: it may contain a password.
            Some(_) => "--database-url \"$KINCAL_DATABASE_URL\"".into(),
            None => format!("--data-dir {:?}", config.database.data_dir),
        };
        eprintln!(
            "There is no key yet, so every request is refused. Make one:\n  kincal key create {store} --name my-cell --scope admin"
        );
    }
    Ok(())
}

/// Resolves on SIGTERM or SIGINT (ctrl-c).
fn stop_signal() -> anyhow::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut terminate, mut interrupt) = (
        signal(SignalKind::terminate())?,
        signal(SignalKind::interrupt())?,
    );
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    })
}

/// Computes until a stop signal.
pub fn work(config: &WorkerConfig) -> anyhow::Result<()> {
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
            attempt_limits(&queue),
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
