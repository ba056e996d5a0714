//! Where a request comes from.

use std::net::IpAddr;

/// The address that a request comes from; the accept loop adds it.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub IpAddr);
