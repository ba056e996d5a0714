//! Real processes that are killed, stopped, starved and filled up under load; afterwards one program checks what was promised.

mod nodes;
#[path = "../support/mod.rs"]
mod support;
use support::{data, engines, preload, process};

mod clock;
mod death;
mod disk;
mod kill;
mod load;
mod lock;
mod power;
mod stop;
