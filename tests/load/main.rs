//! Clients that are slow, too many, too large or hostile: everyone is answered or cut off in time, and the others go on.

#[path = "../support/mod.rs"]
mod support;
use support::{app, people, process, raw};

mod clients;
mod flood;
mod headers;
mod hostile;
mod memory;
mod readers;
