//! Connections, below the requests: they are accepted, encrypted, read, and closed without losing an answer.

mod accept;
mod lingering;
pub mod server;
pub mod tls;
mod unreadable;
