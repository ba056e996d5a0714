//! A client that writes bytes that no HTTP library would send.
#![allow(dead_code)] // each test binary uses its part

use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// Timeout that no test exceeds, even on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub struct Raw(pub TcpStream);

impl Raw {
    pub async fn connect(address: std::net::SocketAddr) -> Self {
        Self(
            TcpStream::connect(address)
                .await
                .expect("the server accepts"),
        )
    }

    /// Sends bytes. Returns false if the server has closed the connection.
    pub async fn send(&mut self, bytes: &[u8]) -> bool {
        self.0.write_all(bytes).await.is_ok()
    }

    /// Reads until the server closes the connection.
    pub async fn rest(&mut self) -> String {
        let mut bytes = Vec::new();
        let end = timeout(PATIENCE, self.0.read_to_end(&mut bytes))
            .await
            .expect("the server closes the connection");
        // A reset is a close, too.
        drop(end);
        String::from_utf8_lossy(&bytes).into_owned()
    }

    /// Sends one byte every `pause` until the server disconnects. Returns the time that this took, and the answer.
    pub async fn dribble(mut self, first: &[u8], byte: u8, pause: Duration) -> (Duration, String) {
        let begun = Instant::now();
        self.send(first).await;
        let (mut reader, mut writer) = self.0.into_split();
        let dribble = tokio::spawn(async move {
            while writer.write_all(&[byte]).await.is_ok() {
                tokio::time::sleep(pause).await
            }
        });
        let mut bytes = Vec::new();
        let _ = timeout(PATIENCE, reader.read_to_end(&mut bytes))
            .await
            .expect("the server closes the connection");
        dribble.abort();
        (
            begun.elapsed(),
            String::from_utf8_lossy(&bytes).into_owned(),
        )
    }
}
