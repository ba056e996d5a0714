//! `kincal serve`.

use super::runtime::block_on;
use super::usage::Usage;
use crate::config::ServeConfig;
use crate::http::server::{self, RunningServer};
use crate::store::{ListRequest, api_keys};
use crate::telemetry;
use std::io::Write;

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
pub fn stop_signal() -> anyhow::Result<impl Future<Output = ()>> {
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
