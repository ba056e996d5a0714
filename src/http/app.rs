//! State that all handlers share.

use crate::config::ServeConfig;
use crate::http::Error;
use crate::http::counters::Metrics;
use crate::http::limits::{Limits, RequestClass};
use crate::jobs::JobSignals;
use crate::store::Store;
use tokio::sync::watch;

/// State of one server.
#[derive(Clone, Debug)]
pub struct App {
    /// The database.
    pub store: Store,
    /// True with `--no-auth`: requests need no key.
    pub no_auth: bool,
    /// True if the server itself speaks TLS.
    pub has_tls: bool,
    /// Becomes true when shutdown begins: long polls and event streams end.
    pub stopping: watch::Receiver<bool>,
    /// Wakes workers, long polls and event streams.
    pub signals: JobSignals,
    pub(super) limits: Limits,
    pub(super) metrics: Metrics,
}

/// Resolves when shutdown begins. If the sender is dropped, nobody can stop the server: it runs until the process ends.
pub(super) async fn shutdown_begun(mut stopping: watch::Receiver<bool>) {
    if stopping.wait_for(|stop| *stop).await.is_err() {
        std::future::pending::<()>().await;
    }
}

impl App {
    /// The state of a server on this store.
    pub fn new(
        store: Store,
        config: &ServeConfig,
        stopping: watch::Receiver<bool>,
        signals: JobSignals,
    ) -> Self {
        let limits = Limits::new(&config.limits, config.no_auth);
        Self {
            store,
            no_auth: config.no_auth,
            has_tls: config.tls.files().is_some(),
            stopping,
            signals,
            limits,
            metrics: Metrics::default(),
        }
    }

    /// Resolves when shutdown begins.
    pub async fn stopped(&self) {
        shutdown_begun(self.stopping.clone()).await;
    }

    /// Waits for a permit and runs `work` on a blocking thread.
    ///
    /// # Errors
    /// The error of `work`; [`Error::Busy`] if no permit becomes free in time.
    pub(super) async fn compute<T: Send + 'static>(
        &self,
        class: RequestClass,
        work: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.limits.compute_permit(class).await?.run(work).await
    }
}
