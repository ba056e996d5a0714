//! Load tests: slow, numerous, large and hostile clients are answered or disconnected in time, and others are served meanwhile.

#[path = "../support/mod.rs"]
mod support;
use support::{app, people, process, raw};

mod cancel;
mod clients;
mod flood;
mod headers;
mod hostile;
mod memory;
mod readers;
