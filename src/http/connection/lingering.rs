//! Lingering close: lets a client read its refusal even if it is still sending (a body that is too large). A plain close would reset the
//! connection, and the answer would be lost.

use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::time::timeout;

/// Longest wait for a client that sends nothing.
const IDLE_TIMEOUT: Duration = Duration::from_secs(1);
/// Longest time of a lingering close.
const TOTAL_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum number of bytes that are read and discarded: twice the largest body.
const MAX_BYTES: usize = 64 << 20;
/// Size of one read.
const CHUNK_BYTES: usize = 16 * 1024;

/// Reads and discards what a client still sends, after the writing side was closed. Returns when the client closes, or at a limit.
pub async fn linger(stream: &mut (impl AsyncRead + Unpin)) {
    let mut chunk = vec![0; CHUNK_BYTES];
    let mut bytes_left = MAX_BYTES;
    let drain = async {
        // A reset is a close, too.
        while let Ok(Ok(n @ 1..)) = timeout(IDLE_TIMEOUT, stream.read(&mut chunk)).await {
            bytes_left = bytes_left.saturating_sub(n);
            if bytes_left == 0 {
                return;
            }
        }
    };
    let _ = timeout(TOTAL_TIMEOUT, drain).await;
}

#[cfg(test)]
mod tests {
    use super::{MAX_BYTES, linger};
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

    async fn close(mut stream: TcpStream) {
        stream.shutdown().await.unwrap();
        linger(&mut stream).await;
    }

    #[tokio::test]
    async fn a_client_that_is_sending_still_reads_the_last_answer() {
        let (mut client, mut server) = pair().await;
        let closing = tokio::spawn(async move {
            server.write_all(b"too large").await.unwrap();
            close(server).await;
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
        let (client, mut server) = tokio::io::duplex(1);
        drop(client);
        let closing = pin!(linger(&mut server)).poll(&mut Context::from_waker(Waker::noop()));
        assert!(closing.is_ready());
    }

    #[tokio::test]
    async fn a_client_that_does_not_close_is_not_waited_for() {
        let (client, server) = pair().await;
        close(server).await;
        drop(client);
        let (mut client, server) = pair().await;
        let sending =
            tokio::spawn(async move { while client.write_all(&[0; 1 << 20]).await.is_ok() {} });
        close(server).await;
        sending.await.unwrap();
    }
}
