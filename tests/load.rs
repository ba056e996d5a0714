//! Clients that are slow, too many, too large or hostile: everyone is answered or cut off in time, and the others go on.

#[path = "support/app.rs"]
mod app;
#[path = "load/clients.rs"]
mod clients;
#[path = "load/flood.rs"]
mod flood;
#[path = "load/headers.rs"]
mod headers;
#[path = "load/hostile.rs"]
mod hostile;
#[path = "load/memory.rs"]
mod memory;
#[path = "support/people.rs"]
mod people;
#[path = "support/process.rs"]
mod process;
#[path = "support/raw.rs"]
mod raw;
#[path = "load/readers.rs"]
mod readers;
