//! The threads that talk to clients, apart from the caller's. A server that is asked for ten times what it can do refuses nine of ten
//! requests. Where refusing shares its threads with answering, each step of an upload waits behind all of the refusals, and hardly any upload
//! comes to its end. So requests that are taken are handed on to the caller's threads. Not so where few clients are connected and the database
//! is SQLite: a step waits behind one short step of each of the others at most, statements run on the thread that asks, most answers are
//! one step, and to hand that on and back would take longer than many an answer.

use crate::http::admission::{Limits, MAX_WRITES};
use crate::http::class::Class;
use crate::http::metrics::Metrics;
use crate::http::{App, Error, layers, router};
use crate::store::Engine;
use axum::Router;
use axum::extract::Request;
use axum::response::{IntoResponse, Response};
use std::convert::Infallible;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, EnterGuard, Handle, Runtime};
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
        let runtime = Builder::new_multi_thread()
            .thread_name("kincal-front")
            .enable_all()
            .build()?;
        Ok(Self {
            handle: runtime.handle().clone(),
            runtime: Some(runtime),
        })
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

    /// Where the tasks of workers run. On SQLite here: the thread that has posted a job then goes on with its claim, and another one need not
    /// wake for that. What they compute has threads of its own.
    pub fn home_of_workers(&self, engine: Engine) -> Option<EnterGuard<'_>> {
        (engine == Engine::Sqlite).then(|| self.handle.enter())
    }

    /// Runs something on them.
    pub fn spawn(&self, work: impl Future<Output = ()> + Send + 'static) -> JoinHandle<()> {
        self.handle.spawn(work)
    }
}

/// Ends a front that nobody else has any more, and waits so long for what runs there still.
pub async fn end(front: Arc<Front>, within: Duration) {
    let Some(runtime) = Arc::into_inner(front).and_then(|mut front| front.runtime.take()) else {
        return;
    };
    // on a thread that may wait
    let _ = tokio::task::spawn_blocking(move || runtime.shutdown_timeout(within)).await;
}

impl Drop for Front {
    fn drop(&mut self) {
        // Not by waiting: a thread of another runtime must not.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Answers requests: refuses at the door what there is no room for, and answers the rest or hands it on.
#[derive(Clone, Debug)]
pub struct Desk {
    router: Router,
    limits: Limits,
    metrics: Metrics,
    /// Whose threads answer, where the front's do not.
    others: Handle,
    /// Connections up to which the front's threads do.
    few: usize,
}

impl Desk {
    /// For this server; requests are handed on to the threads of the caller.
    pub fn new(app: App) -> Self {
        let (limits, metrics) = (app.limits.clone(), app.metrics.clone());
        let few = match app.store.engine() {
            Engine::Sqlite => MAX_WRITES,
            Engine::Postgres => 0,
        };
        Self {
            router: router(app),
            limits,
            metrics,
            others: Handle::current(),
            few,
        }
    }

    /// Counts a client that was sent away before it could ask for anything.
    pub fn turned_away(&self, code: &str) {
        self.metrics.turned_away(code);
    }

    /// The answer to a request while so many are connected. If whoever waits for it goes away, work on it ends.
    pub async fn answer(
        self,
        request: Request,
        n_connected: usize,
    ) -> Result<Response, Infallible> {
        if !self
            .limits
            .has_room(Class::of(request.method(), request.uri().path()))
        {
            return Ok(layers::refuse_at_the_door(&self.metrics, request.method()));
        }
        let answer = self.router.oneshot(request);
        if n_connected <= self.few {
            return answer.await;
        }
        let mut work = JoinSet::new();
        work.spawn_on(answer, &self.others);
        match work.join_next().await {
            Some(Ok(answer)) => answer,
            _ => Ok(
                Error::Internal("the server ended with a request under way".into()).into_response(),
            ),
        }
    }
}
