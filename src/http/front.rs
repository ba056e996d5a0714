//! The threads that talk to clients, apart from those that work. A server that is asked for ten times what it can do refuses nine of ten
//! requests: where refusing shared its threads with working, each step of an upload waited behind all of the refusals, and hardly any
//! upload came to its end.

use crate::http::admission::Limits;
use crate::http::class::Class;
use crate::http::metrics::Metrics;
use crate::http::{App, Error, layers, router};
use axum::Router;
use axum::extract::Request;
use axum::response::{IntoResponse, Response};
use std::convert::Infallible;
use std::io;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::task::{JoinHandle, JoinSet};
use tower::ServiceExt;

/// Threads of their own for connections. They end when this is dropped.
#[derive(Debug)]
pub struct Front {
    handle: Handle,
    runtime: Option<Runtime>,
}

impl Front {
    /// Starts them, one for each core.
    ///
    /// # Errors
    /// If the operating system gives no threads.
    pub fn start() -> io::Result<Self> {
        let runtime = Builder::new_multi_thread().thread_name("kincal-front").enable_all().build()?;
        Ok(Self { handle: runtime.handle().clone(), runtime: Some(runtime) })
    }

    /// Lets them watch a socket.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn adopt(&self, listener: TcpListener) -> io::Result<TcpListener> {
        // A socket belongs to the runtime that it was made on.
        let listener = listener.into_std()?;
        let _here = self.handle.enter();
        TcpListener::from_std(listener)
    }

    /// Runs something on them.
    pub fn spawn(&self, work: impl Future<Output = ()> + Send + 'static) -> JoinHandle<()> {
        self.handle.spawn(work)
    }
}

impl Drop for Front {
    fn drop(&mut self) {
        // Not by waiting: a thread of another runtime must not.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Answers requests: refuses at the door what there is no room for, and hands the rest to the threads that work.
#[derive(Clone, Debug)]
pub struct Desk {
    router: Router,
    limits: Limits,
    metrics: Metrics,
    work: Handle,
}

impl Desk {
    /// For a server whose work is done on the threads of the caller.
    pub fn new(app: App) -> Self {
        let (limits, metrics) = (app.limits.clone(), app.metrics.clone());
        Self { router: router(app), limits, metrics, work: Handle::current() }
    }

    /// Counts a client that was sent away before it could ask for anything.
    pub fn turned_away(&self, code: &str) {
        self.metrics.turned_away(code);
    }

    /// The answer to a request. If whoever waits for it goes away, work on it ends.
    pub async fn answer(self, request: Request) -> Result<Response, Infallible> {
        if !self.limits.has_room(Class::of(request.method(), request.uri().path())) {
            return Ok(layers::refuse_at_the_door(&self.metrics, request.method()));
        }
        let mut work = JoinSet::new();
        work.spawn_on(self.router.oneshot(request), &self.work);
        match work.join_next().await {
            Some(Ok(answer)) => answer,
            _ => Ok(Error::Internal("the server ended with a request under way".into()).into_response()),
        }
    }
}
