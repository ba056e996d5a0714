//! Fault tests: real processes under load are killed, stopped and starved, and their disks filled. Afterwards `verify-store` checks the promises.

mod jobs;
mod nodes;
#[path = "../support/mod.rs"]
mod support;
use support::{computations, data, engines, fixtures, preload, process};

mod clock;
mod death;
mod disk;
mod kill;
mod load;
mod lock;
mod power;
mod server_process;
mod stop;
