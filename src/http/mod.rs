//! The REST service: one file per resource, each with its `router()`. A handler is four moves: extract, convert, one call,
//! answer.

mod accept;
mod access;
mod admission;
mod answers;
pub mod auth;
mod buckets;
mod class;
mod compensate;
mod creation;
mod dashboard;
mod document;
mod error;
mod export;
mod extract;
mod frames;
mod front;
mod history;
mod index;
mod job_events;
mod job_posting;
mod jobs;
mod layers;
mod lingering;
mod me;
mod measurement_sets;
mod metrics;
mod networks;
mod parameter_sets;
mod policies;
mod pose_plans;
mod predict;
mod recent_sets;
mod release;
mod report_html;
mod robots;
pub mod server;
mod shares;
pub mod tls;
mod turns;
mod upload_check;

pub use document::{json, openapi, yaml};
pub use error::Error;

use crate::config::ServeConfig;
use crate::http::admission::Limits;
use crate::http::metrics::Metrics;
use crate::http::recent_sets::RecentSets;
use crate::http::turns::Turn;
use crate::jobs::JobSignals;
use crate::store::Store;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use tokio::sync::watch;
use utoipa_axum::router::OpenApiRouter;

/// Largest request body, bytes: ten times the largest campaign.
pub const MAX_BODY_BYTES: usize = 32 * 1024 * 1024;

/// What handlers need.
#[derive(Clone, Debug)]
pub struct App {
    /// The database.
    pub store: Store,
    /// True lets everyone in (`--no-auth`).
    pub no_auth: bool,
    /// Turns true when the server is about to stop: long polls and event streams end.
    pub stopping: watch::Receiver<bool>,
    /// Wakes workers, long polls and event streams.
    pub signals: JobSignals,
    limits: Limits,
    metrics: Metrics,
    recent_sets: RecentSets,
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
            stopping,
            signals,
            limits,
            metrics: Metrics::default(),
            recent_sets: RecentSets::default(),
        }
    }

    /// Resolves when the server is about to stop.
    pub async fn stopped(&self) {
        let mut stopping = self.stopping.clone();
        // An error means that whoever could stop it is gone: then it runs as long as the process.
        let told = stopping.wait_for(|stop| *stop).await.is_ok();
        if !told {
            std::future::pending::<()>().await;
        }
    }

    /// A turn to compute. Whoever needs large things from the database to compute takes it first: then those that wait hold none.
    ///
    /// # Errors
    /// [`Error::Busy`] if too many wait already.
    pub async fn turn(&self) -> Result<Turn, Error> {
        self.limits.lines().turn().await
    }

    /// Runs something that computes when it is its turn.
    ///
    /// # Errors
    /// What `work` returns, [`Error::Busy`].
    pub async fn compute<T>(&self, work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        self.turn().await?.run(work)
    }
}

/// Every route with its documentation.
fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .merge(robots::router())
        .merge(measurement_sets::router())
        .merge(frames::router())
        .merge(jobs::router())
        .merge(job_events::router())
        .merge(report_html::router())
        .merge(parameter_sets::router())
        .merge(release::router())
        .merge(policies::router())
        .merge(predict::router())
        .merge(compensate::router())
        .merge(export::router())
        .merge(history::router())
        .merge(pose_plans::router())
        .merge(networks::router())
        .merge(me::router())
        .merge(index::router())
        .merge(dashboard::router())
        .merge(metrics::router())
}

/// The whole service.
pub fn router(app: App) -> Router {
    let (router, _) = routes().split_for_parts();
    let router = router
        .fallback(layers::no_such_route)
        .method_not_allowed_fallback(layers::method_not_allowed);
    let guarded = router
        .layer(from_fn_with_state(app.clone(), admission::ask))
        .layer(from_fn_with_state(app.clone(), auth::authorize))
        .layer(from_fn_with_state(app.clone(), admission::bound))
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES));
    layers::surround(guarded, app.metrics.clone()).with_state(app)
}
