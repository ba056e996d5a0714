//! Starts and stops the service, for `kincal serve`, `kincal demo` and the tests.

use crate::config::{self, STOP_WITHIN, ServeConfig, n_workers};
use crate::http::App;
use crate::http::connection::accept::{self, ConnectionContext};
use crate::http::connection::tls;
use crate::jobs::{AttemptLimits, Compute, JobSignals, WorkerPool, backfill, execution};
use crate::store::{self, Store, StoreLocation};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Why a server did not start.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The settings cannot be used together.
    #[error(transparent)]
    Config(#[from] config::Error),
    /// The database cannot be opened.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// The certificate or its key cannot be used.
    #[error("TLS: {0}")]
    Tls(std::io::Error),
    /// The address cannot be listened on.
    #[error(
        "cannot listen on {address}: {cause}; is another server running there? choose another with --listen"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Error of the operating system.
        cause: std::io::Error,
    },
}

/// A running server. Dropping this value leaves the server running; [`RunningServer::shutdown`] ends it.
#[derive(Debug)]
pub struct RunningServer {
    /// The address that it listens on, with the actual port.
    pub address: SocketAddr,
    /// Its database.
    pub store: Store,
    stop: watch::Sender<bool>,
    serving: JoinHandle<()>,
    scheme: &'static str,
    workers: WorkerPool,
}

impl From<&config::DatabaseConfig> for StoreLocation {
    fn from(database: &config::DatabaseConfig) -> Self {
        match &database.database_url {
            Some(url) => Self::Postgres { url: url.clone() },
            None => Self::Sqlite {
                data_dir: database.data_dir.clone(),
            },
        }
    }
}

/// Rules of the queue in these settings.
pub fn attempt_limits(queue: &config::QueueConfig) -> AttemptLimits {
    AttemptLimits {
        lease: queue.lease(),
        max_attempts: queue.max_attempts,
        max_duration: Duration::from_secs(queue.max_job_s),
    }
}

/// Opens the database, starts the workers, and accepts requests.
pub async fn start(config: &ServeConfig) -> Result<RunningServer, Error> {
    start_with(config, execution::compute).await
}

/// As [`start`], with another function for the workers' computation. Studies pass a function that measures [`execution::compute`].
pub async fn start_with(config: &ServeConfig, compute: Compute) -> Result<RunningServer, Error> {
    config.check()?;
    let tls = config
        .tls
        .files()
        .map(|(certificates, key)| tls::load(certificates, key))
        .transpose()
        .map_err(Error::Tls)?;
    let listen_error = |cause| Error::Listen {
        address: config.listen,
        cause,
    };
    let listener = TcpListener::bind(config.listen)
        .await
        .map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    let store = Store::open((&config.database).into()).await?;
    backfill::backfill_missing(&store).await?;
    let signals = JobSignals::default();
    let workers = WorkerPool::start(
        store.clone(),
        compute,
        n_workers(config.workers),
        attempt_limits(&config.queue),
        signals.clone(),
    );
    let (stop, stopping) = watch::channel(false);
    let scheme = if tls.is_some() { "https" } else { "http" };
    let app = App::new(store.clone(), config, stopping, signals);
    let service = ConnectionContext::new(app, &config.limits, tls);
    Ok(RunningServer {
        address,
        store,
        stop,
        serving: tokio::spawn(accept::accept_all(listener, service)),
        scheme,
        workers,
    })
}

impl RunningServer {
    /// `http://ADDRESS:PORT`, or `https://…`.
    pub fn url(&self) -> String {
        format!("{}://{}", self.scheme, self.address)
    }

    /// Stops the server: accepts no more requests, finishes those under way, lets running jobs end or hands them back, and closes the database.
    /// Takes at most ten seconds, whatever clients do.
    pub async fn shutdown(mut self) {
        self.stop.send_replace(true);
        let requests = async {
            if tokio::time::timeout(STOP_WITHIN, &mut self.serving)
                .await
                .is_err()
            {
                tracing::warn!("some requests did not end in time; their clients are disconnected");
                self.serving.abort();
            }
        };
        tokio::join!(requests, self.workers.shutdown(STOP_WITHIN));
        // Connections to the database that are still busy belong to aborted requests.
        if tokio::time::timeout(Duration::from_secs(1), self.store.close())
            .await
            .is_err()
        {
            tracing::warn!("the database was still in use when the server ended");
        }
    }
}
