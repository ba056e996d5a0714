//! The accept loop, with a limit on connections and timeouts for slow clients; `axum::serve` has neither.

use crate::config::LimitsConfig;
use crate::http::app::shutdown_begun;
use crate::http::auth::Peer;
use crate::http::connection::lingering::linger;
use crate::http::connection::tls::Tls;
use crate::http::connection::unreadable::{self, WithProblems};
use crate::http::counters::Metrics;
use crate::http::limits::Limits;
use crate::http::route::class_of;
use crate::http::router::router;
use crate::http::routes::ROUTES;
use crate::http::{App, layers};
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::Pin;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout, timeout_at};
use tokio_io_timeout::TimeoutStream;
use tower::ServiceExt;

/// Size of hyper's read buffer, which bounds the header. Cell PCs send headers under a kilobyte.
const MAX_HEADER_BYTES: usize = 32 * 1024;
/// Pause after a failed `accept` (out of file descriptors).
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(50);
/// Grace period at shutdown: connections and requests that arrive this long after the signal are still accepted and answered.
const SHUTDOWN_GRACE: Duration = Duration::from_millis(100);
/// Maximum number of connections accepted during [`SHUTDOWN_GRACE`]. The same limit applies to those that the operating system has queued by
/// its end.
const MAX_ACCEPTED_AT_SHUTDOWN: usize = 4096;
/// Maximum number of clients that receive [`TOO_MANY_CONNECTIONS_ANSWER`] at the same time. Other clients are disconnected without an answer.
const MAX_TURNED_AWAY: usize = 256;
/// Longest time for sending [`TOO_MANY_CONNECTIONS_ANSWER`] and for the client to read it.
const TURN_AWAY_TIMEOUT: Duration = Duration::from_secs(1);
/// Code of [`TOO_MANY_CONNECTIONS_ANSWER`] and of its counter.
const TOO_MANY_CONNECTIONS: &str = "too_many_connections";
/// Answer to a client beyond the connection limit. A TLS client is disconnected without it, because a handshake costs more than the limit saves.
const TOO_MANY_CONNECTIONS_ANSWER: &[u8] = b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
connection: close\r\ncontent-length: 186\r\n\r\n{\"type\":\"urn:kincal:problem:too_many_connections\",\"title\":\"Too many connections\",\"status\":503,\
\"detail\":\"the server has no room for more clients: try again\",\"code\":\"too_many_connections\"}";

/// HSTS for a year (RFC 6797).
const HSTS_ONE_YEAR: HeaderValue = HeaderValue::from_static("max-age=31536000");

/// State that all connections share.
#[derive(Clone)]
pub struct ConnectionContext {
    router: Router,
    limits: Limits,
    metrics: Metrics,
    client_timeout: Duration,
    max_connections: usize,
    tls: Option<Tls>,
    stopping: watch::Receiver<bool>,
}

impl ConnectionContext {
    /// Creates the state of one server.
    pub fn new(app: App, config: &LimitsConfig, tls: Option<Tls>) -> Self {
        Self {
            limits: app.limits.clone(),
            metrics: app.metrics.clone(),
            stopping: app.stopping.clone(),
            client_timeout: config.client_timeout(),
            max_connections: config.max_connections,
            router: router(app),
            tls,
        }
    }

    /// Answers one request. Without a free permit the request is refused before routing.
    async fn answer(self, request: Request) -> Response {
        let common = self.headers();
        let class = class_of(ROUTES, request.method(), request.uri().path());
        let is_limited = !layers::is_unlimited(request.uri());
        let permit = is_limited.then(|| self.limits.admit(class)).transpose();
        let mut answer = match permit {
            Ok(_permit) => match self.router.oneshot(request).await {
                Ok(answer) => answer,
                Err(never) => match never {},
            },
            Err(busy) => layers::refuse_unrouted(&self.metrics, request.method(), busy),
        };
        answer.headers_mut().extend(common);
        answer
    }

    /// Headers of every answer, including hyper's own.
    fn headers(&self) -> HeaderMap {
        let hsts = (header::STRICT_TRANSPORT_SECURITY, HSTS_ONE_YEAR);
        self.tls.iter().map(|_| hsts.clone()).collect()
    }
}

/// Accepts clients until shutdown has begun and its grace period is over. Returns when the last request under way is answered.
pub async fn accept_all(listener: TcpListener, service: ConnectionContext) {
    let mut connections = Connections::default();
    let stopped = shutdown_begun(service.stopping.clone());
    tokio::pin!(stopped);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = &mut stopped => break,
        };
        match accepted {
            Ok((stream, peer)) => connections.admit(stream, peer, &service),
            Err(error) => {
                tracing::warn!(%error, "a client could not be accepted");
                sleep(ACCEPT_RETRY_DELAY).await;
            }
        }
    }
    let grace_end = Instant::now() + SHUTDOWN_GRACE;
    for _ in 0..MAX_ACCEPTED_AT_SHUTDOWN {
        let Ok(Ok((stream, peer))) = timeout_at(grace_end, listener.accept()).await else {
            break;
        };
        connections.admit(stream, peer, &service);
    }
    // Accepts the connections that the operating system has queued and tokio has not reported yet. Then the socket is closed.
    if let Ok(listener) = listener.into_std() {
        for _ in 0..MAX_ACCEPTED_AT_SHUTDOWN {
            let Ok((stream, peer)) = listener.accept() else {
                break;
            };
            if let Ok(stream) = stream
                .set_nonblocking(true)
                .and_then(|()| TcpStream::from_std(stream))
            {
                connections.admit(stream, peer, &service);
            }
        }
    }
    connections.end().await;
}

/// The open connections. Each has one task, so the number of tasks is the number of connections.
#[derive(Default)]
struct Connections {
    served: JoinSet<()>,
    turned_away: JoinSet<()>,
}

impl Connections {
    /// Serves a client, or turns it away if too many are connected.
    fn admit(&mut self, stream: TcpStream, peer: SocketAddr, service: &ConnectionContext) {
        for tasks in [&mut self.served, &mut self.turned_away] {
            while tasks.try_join_next().is_some() {}
        }
        if self.served.len() < service.max_connections {
            self.served.spawn(connection(stream, peer, service.clone()));
            return;
        }
        service
            .metrics
            .record_refused_connection(TOO_MANY_CONNECTIONS);
        if self.turned_away.len() < MAX_TURNED_AWAY && service.tls.is_none() {
            self.turned_away.spawn(turn_away(stream));
        }
    }

    /// Returns when every connection has ended.
    async fn end(mut self) {
        while self.served.join_next().await.is_some() {}
        while self.turned_away.join_next().await.is_some() {}
    }
}

async fn connection(stream: TcpStream, peer: SocketAddr, service: ConnectionContext) {
    // Answers are small; do not delay them.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    // Disconnects clients that do not read their answers. There is no read timeout here, because long polls are silent: hyper limits the time
    // of headers, `whole_body` that of bodies.
    stream.set_write_timeout(Some(service.client_timeout));
    let stream = Box::pin(stream);
    match &service.tls {
        None => requests(stream, peer, &service).await,
        Some(tls) => {
            if let Ok(Ok(stream)) = timeout(service.client_timeout, tls.accept(stream)).await {
                requests(stream, peer, &service).await;
            }
        }
    }
}

/// Answers the requests of one connection, one after the other.
async fn requests(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    peer: SocketAddr,
    service: &ConnectionContext,
) {
    let answer = |mut request: hyper::Request<hyper::body::Incoming>| {
        request.extensions_mut().insert(Peer(peer.ip()));
        let answer = service.clone().answer(request.map(Body::new));
        async move { Ok::<_, Infallible>(answer.await) }
    };
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(service.client_timeout)
        .max_buf_size(MAX_HEADER_BYTES);
    let stream = TokioIo::new(WithProblems::new(stream, service.headers()));
    let mut connection = builder.serve_connection(stream, service_fn(answer));
    let mut serving = Pin::new(&mut connection);
    // Waits for requests that are still arriving: hyper's graceful shutdown drops a request that it has not read.
    let grace_end = async {
        shutdown_begun(service.stopping.clone()).await;
        sleep(SHUTDOWN_GRACE).await;
    };
    let ended = tokio::select! {
        ended = &mut serving => ended,
        () = grace_end => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    // Only unreadable requests are counted; other errors of a connection are the client's.
    if let Some(code) = ended.err().as_ref().and_then(unreadable::problem_code) {
        service.metrics.record_refused_connection(code);
    }
    if let Some(mut stream) = connection.into_parts().io.into_inner().closed() {
        linger(&mut stream).await;
    }
}

/// Sends [`TOO_MANY_CONNECTIONS_ANSWER`], waits until the client has read it, and closes the connection.
async fn turn_away(mut stream: TcpStream) {
    let _ = timeout(TURN_AWAY_TIMEOUT, async {
        stream.write_all(TOO_MANY_CONNECTIONS_ANSWER).await?;
        stream.shutdown().await?;
        linger(&mut stream).await;
        std::io::Result::Ok(())
    })
    .await;
}

#[cfg(test)]
mod tests {
    use super::{TOO_MANY_CONNECTIONS, TOO_MANY_CONNECTIONS_ANSWER};

    #[test]
    fn the_answer_to_a_connection_too_many_has_the_length_that_it_says() {
        let text = std::str::from_utf8(TOO_MANY_CONNECTIONS_ANSWER).unwrap();
        let (header, body) = text.split_once("\r\n\r\n").unwrap();
        assert!(
            header.contains(&format!("content-length: {}", body.len())),
            "{}",
            body.len()
        );
        let problem: crate::wire::Problem = serde_json::from_str(body).unwrap();
        let expected = crate::wire::Problem::new(503, TOO_MANY_CONNECTIONS, problem.detail.clone());
        assert_eq!(problem, expected);
    }
}
