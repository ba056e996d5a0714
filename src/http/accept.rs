//! The accept loop: how many may be connected, and how long a client may keep the server waiting.
//! `axum::serve` has neither limit.

use crate::config::LimitsConfig;
use crate::http::front::Desk;
use crate::http::lingering::Lingering;
use crate::http::tls::Tls;
use axum::body::Body;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout, timeout_at};
use tokio_io_timeout::TimeoutStream;

/// Largest header; cell PCs send under a kilobyte.
const MAX_HEADER_BYTES: usize = 32 * 1024;
/// A failed `accept` (out of file descriptors) is tried again after this.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);
/// After the word to stop those are let in and heard for this long who are connected as far as they know: closing the listener, or a
/// connection before its first request, cuts them off. Long enough for a client on a busy machine, or some hops away, to send what it began.
const LAST_CALL: Duration = Duration::from_millis(100);
/// How many: as many as the operating system keeps waiting, or they would never end.
const MAX_LAST: usize = 4096;
/// Clients that are turned away politely at the same time; more are just closed.
const MAX_TURNED_AWAY: usize = 256;
/// How long one that is turned away may take to read the reason.
const TURN_AWAY_WITHIN: Duration = Duration::from_secs(1);
/// What [`TURNED_AWAY`] says, and what is counted of it.
const TOO_MANY_CONNECTIONS: &str = "too_many_connections";
/// The whole answer to a connection too many. Without TLS only: a handshake costs more than the answer.
const TURNED_AWAY: &[u8] = b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\nretry-after: 1\r\n\
connection: close\r\ncontent-length: 186\r\n\r\n{\"type\":\"urn:kincal:problem:too_many_connections\",\"title\":\"Too many connections\",\"status\":503,\
\"detail\":\"the server has no room for more clients: try again\",\"code\":\"too_many_connections\"}";

/// Where a request comes from.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub IpAddr);

/// What all connections share.
#[derive(Clone)]
struct Serving {
    desk: Desk,
    client_timeout: Duration,
    tls: Option<Tls>,
    stopping: watch::Receiver<bool>,
    /// Room for more connections, of so many.
    room: Arc<Semaphore>,
    max_connections: usize,
}

impl Serving {
    fn n_connected(&self) -> usize {
        self.max_connections
            .saturating_sub(self.room.available_permits())
    }
}

/// Answers clients until told to stop, then until the last request under way is answered.
pub async fn accept_all(
    listener: TcpListener,
    desk: Desk,
    limits: &LimitsConfig,
    tls: Option<Tls>,
    stopping: watch::Receiver<bool>,
) {
    let LimitsConfig {
        max_connections, ..
    } = *limits;
    let room = Arc::new(Semaphore::new(max_connections));
    let (client_timeout, listening) = (limits.client_timeout(), stopping.clone());
    let serving = Serving {
        desk,
        client_timeout,
        tls,
        stopping: listening,
        room: Arc::clone(&room),
        max_connections,
    };
    let room_to_turn_away = Arc::new(Semaphore::new(MAX_TURNED_AWAY));
    let mut connections = JoinSet::new();
    let admit = |(stream, peer), connections: &mut JoinSet<()>| match Arc::clone(&room)
        .try_acquire_owned()
    {
        Ok(slot) => drop(connections.spawn(connection(stream, peer, serving.clone(), slot))),
        Err(_) => {
            serving.desk.turned_away(TOO_MANY_CONNECTIONS);
            let room = Arc::clone(&room_to_turn_away)
                .try_acquire_owned()
                .ok()
                .filter(|_| serving.tls.is_none());
            drop(room.map(|slot| connections.spawn(turn_away(stream, slot))));
        }
    };
    let stopped = told_to_stop(stopping);
    tokio::pin!(stopped);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = connections.join_next(), if !connections.is_empty() => continue,
            () = &mut stopped => break,
        };
        match accepted {
            Ok(client) => admit(client, &mut connections),
            Err(error) => {
                tracing::warn!(%error, "a client could not be accepted");
                sleep(ACCEPT_AGAIN).await;
            }
        }
    }
    let last_call = Instant::now() + LAST_CALL;
    for _ in 0..MAX_LAST {
        let Ok(Ok(client)) = timeout_at(last_call, listener.accept()).await else {
            break;
        };
        admit(client, &mut connections);
    }
    // what came since the runtime last heard of this socket: it is asked itself, and closed at once
    if let Ok(listener) = listener.into_std() {
        for _ in 0..MAX_LAST {
            let Ok((stream, peer)) = listener.accept() else {
                break;
            };
            if let Ok(stream) = stream
                .set_nonblocking(true)
                .and_then(|()| TcpStream::from_std(stream))
            {
                admit((stream, peer), &mut connections);
            }
        }
    }
    while connections.join_next().await.is_some() {}
}

async fn told_to_stop(mut stopping: watch::Receiver<bool>) {
    // An error means that whoever could stop it is gone: then it runs as long as the process.
    if stopping.wait_for(|stop| *stop).await.is_err() {
        std::future::pending::<()>().await;
    }
}

async fn connection(
    stream: TcpStream,
    peer: SocketAddr,
    serving: Serving,
    _slot: OwnedSemaphorePermit,
) {
    // Answers are small and awaited.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    // A client that does not read its answer. Reading has no such limit: long polls are silent; hyper watches headers, `whole_body` bodies.
    stream.set_write_timeout(Some(serving.client_timeout));
    let stream = Box::pin(stream);
    match &serving.tls {
        None => requests(Lingering::new(stream), peer, &serving).await,
        Some(tls) => {
            if let Ok(Ok(stream)) = timeout(serving.client_timeout, tls.accept(stream)).await {
                requests(Lingering::new(stream), peer, &serving).await;
            }
        }
    }
}

/// The requests of one connection, one after the other.
async fn requests(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    peer: SocketAddr,
    serving: &Serving,
) {
    let answer = |mut request: hyper::Request<hyper::body::Incoming>| {
        request.extensions_mut().insert(Peer(peer.ip()));
        serving
            .desk
            .clone()
            .answer(request.map(Body::new), serving.n_connected())
    };
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(serving.client_timeout)
        .max_buf_size(MAX_HEADER_BYTES);
    let connection =
        builder.serve_connection(TokioIo::new(stream), hyper::service::service_fn(answer));
    tokio::pin!(connection);
    // Clients come and go as they like, so how a connection ended is of no interest.
    // A request may be on its way already, and one that was not read yet is not waited for by what follows.
    let last_call = async {
        told_to_stop(serving.stopping.clone()).await;
        sleep(LAST_CALL).await;
    };
    tokio::select! {
        _ = &mut connection => return,
        () = last_call => connection.as_mut().graceful_shutdown(),
    }
    let _ = connection.await;
}

/// Says why, waits until it was read, and closes.
async fn turn_away(stream: TcpStream, _slot: OwnedSemaphorePermit) {
    let mut stream = Lingering::new(stream);
    let _ = timeout(TURN_AWAY_WITHIN, async {
        stream.write_all(TURNED_AWAY).await?;
        stream.shutdown().await
    })
    .await;
}

#[cfg(test)]
mod tests {
    use super::{TOO_MANY_CONNECTIONS, TURNED_AWAY};

    #[test]
    fn the_answer_to_a_connection_too_many_has_the_length_that_it_says() {
        let text = std::str::from_utf8(TURNED_AWAY).unwrap();
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
