//! Lingering close: lets a client read its refusal even if it is still sending (a body that is too large). A plain close would reset the
//! connection, and the answer would be lost.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

/// Longest wait for a client that sends nothing.
const IDLE_TIMEOUT: Duration = Duration::from_secs(1);
/// Longest time of a lingering close.
const TOTAL_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum number of bytes that are read and discarded: twice the largest body.
const MAX_BYTES: usize = 64 << 20;
/// Size of one read.
const CHUNK_BYTES: usize = 16 * 1024;

/// A stream with a lingering shutdown: it closes the writing side, then reads and discards until the client closes or a limit is reached.
#[derive(Debug)]
pub struct Lingering<S> {
    stream: S,
    draining: Option<Draining>,
}

#[derive(Debug)]
struct Draining {
    until: Instant,
    idle: Pin<Box<Sleep>>,
    bytes_left: usize,
}

impl<S> Lingering<S> {
    /// Wraps a stream.
    pub fn new(stream: S) -> Self {
        Self {
            stream,
            draining: None,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Lingering<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        to: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, to)
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> AsyncWrite for Lingering<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Self { stream, draining } = &mut *self;
        if draining.is_none() {
            ready!(Pin::new(&mut *stream).poll_shutdown(context))?;
        }
        let Draining {
            until,
            idle,
            bytes_left,
        } = draining.get_or_insert_with(|| Draining {
            until: Instant::now() + TOTAL_TIMEOUT,
            idle: Box::pin(sleep(IDLE_TIMEOUT)),
            bytes_left: MAX_BYTES,
        });
        let mut buffer = [0_u8; CHUNK_BYTES];
        loop {
            let mut chunk = ReadBuf::new(&mut buffer);
            match Pin::new(&mut *stream).poll_read(context, &mut chunk) {
                // A reset is a close, too.
                Poll::Ready(Err(_)) => return Poll::Ready(Ok(())),
                Poll::Ready(Ok(())) if chunk.filled().is_empty() => return Poll::Ready(Ok(())),
                Poll::Ready(Ok(())) => {
                    *bytes_left = bytes_left.saturating_sub(chunk.filled().len());
                    let now = Instant::now();
                    if *bytes_left == 0 || now >= *until {
                        return Poll::Ready(Ok(()));
                    }
                    idle.as_mut().reset((now + IDLE_TIMEOUT).min(*until));
                }
                Poll::Pending => return idle.as_mut().poll(context).map(Ok),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Lingering, MAX_BYTES};
    use std::pin::pin;
    use std::task::{Context, Waker};
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::{TcpListener, TcpStream};

    async fn pair() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let (client, server) = tokio::join!(client, listener.accept());
        (client.unwrap(), server.unwrap().0)
    }

    #[tokio::test]
    async fn a_client_that_is_sending_still_reads_the_last_answer() {
        let (mut client, server) = pair().await;
        let closing = tokio::spawn(async move {
            let mut server = Lingering::new(server);
            server.write_all(b"too large").await.unwrap();
            server.shutdown().await.unwrap();
        });
        let body = vec![0; MAX_BYTES / 8];
        client.write_all(&body).await.unwrap();
        let mut answer = Vec::new();
        client.read_to_end(&mut answer).await.unwrap();
        assert_eq!(answer, b"too large");
        drop(client);
        closing.await.unwrap();
    }

    #[tokio::test]
    async fn a_client_that_has_closed_is_not_waited_for() {
        let (client, server) = tokio::io::duplex(1);
        drop(client);
        let mut server = Lingering::new(server);
        let closing = pin!(server.shutdown()).poll(&mut Context::from_waker(Waker::noop()));
        assert!(closing.is_ready());
    }

    #[tokio::test]
    async fn a_client_that_does_not_close_is_not_waited_for() {
        let (client, server) = pair().await;
        Lingering::new(server).shutdown().await.unwrap();
        drop(client);
        let (mut client, server) = pair().await;
        let sending =
            tokio::spawn(async move { while client.write_all(&[0; 1 << 20]).await.is_ok() {} });
        Lingering::new(server).shutdown().await.unwrap();
        sending.await.unwrap();
    }
}
