//! Closing a connection so that the client hears the last answer. A client that is refused while it sends, a body that is too large for
//! instance, would be told that the connection is reset, and would not read why.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

/// A client that has not closed its side and sends nothing for this long is not waited for.
const SILENCE: Duration = Duration::from_secs(1);
/// Nor is one that sends for this long, or this much: twice the largest body.
const LONGEST: Duration = Duration::from_secs(10);
const MOST_BYTES: usize = 64 << 20;
/// Read and thrown away at a time.
const PIECE_BYTES: usize = 16 * 1024;

/// A stream whose shutdown says that nothing more will come, and then waits until the client has closed its side, within bounds.
#[derive(Debug)]
pub struct Lingering<S> {
    stream: S,
    goodbye: Option<Goodbye>,
}

#[derive(Debug)]
struct Goodbye {
    until: Instant,
    silence: Pin<Box<Sleep>>,
    bytes_left: usize,
}

impl<S> Lingering<S> {
    /// Around this stream.
    pub fn new(stream: S) -> Self {
        Self {
            stream,
            goodbye: None,
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
        let Self { stream, goodbye } = &mut *self;
        if goodbye.is_none() {
            ready!(Pin::new(&mut *stream).poll_shutdown(context))?;
        }
        let Goodbye {
            until,
            silence,
            bytes_left,
        } = goodbye.get_or_insert_with(|| Goodbye {
            until: Instant::now() + LONGEST,
            silence: Box::pin(sleep(SILENCE)),
            bytes_left: MOST_BYTES,
        });
        let mut unread = [0_u8; PIECE_BYTES];
        loop {
            let mut piece = ReadBuf::new(&mut unread);
            match Pin::new(&mut *stream).poll_read(context, &mut piece) {
                // it may also say so by resetting the connection
                Poll::Ready(Err(_)) => return Poll::Ready(Ok(())),
                Poll::Ready(Ok(())) if piece.filled().is_empty() => return Poll::Ready(Ok(())),
                Poll::Ready(Ok(())) => {
                    *bytes_left = bytes_left.saturating_sub(piece.filled().len());
                    let now = Instant::now();
                    if *bytes_left == 0 || now >= *until {
                        return Poll::Ready(Ok(()));
                    }
                    silence.as_mut().reset((now + SILENCE).min(*until));
                }
                Poll::Pending => return silence.as_mut().poll(context).map(Ok),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Lingering, MOST_BYTES, SILENCE};
    use std::time::Instant;
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
        let body = vec![0; MOST_BYTES / 8];
        client.write_all(&body).await.unwrap();
        let mut answer = Vec::new();
        client.read_to_end(&mut answer).await.unwrap();
        assert_eq!(answer, b"too large");
        let begun = Instant::now();
        drop(client);
        closing.await.unwrap();
        assert!(
            begun.elapsed() < SILENCE / 2,
            "who has closed is not waited for"
        );
    }

    #[tokio::test]
    async fn a_client_that_does_not_close_is_not_waited_for() {
        let (client, server) = pair().await;
        let begun = Instant::now();
        Lingering::new(server).shutdown().await.unwrap();
        assert!(
            begun.elapsed() >= SILENCE && begun.elapsed() < 4 * SILENCE,
            "{:?}",
            begun.elapsed()
        );
        drop(client);
        let (mut client, server) = pair().await;
        let sending =
            tokio::spawn(async move { while client.write_all(&[0; 1 << 20]).await.is_ok() {} });
        Lingering::new(server).shutdown().await.unwrap();
        sending.await.unwrap();
    }
}
