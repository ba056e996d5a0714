//! The client's address.

use std::net::IpAddr;

/// Address of the client; the accept loop adds it to each request.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub IpAddr);
