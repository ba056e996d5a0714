//! Real processes that are killed, stopped, starved and filled up under load; afterwards one program checks what was promised.

#[path = "faults/clock.rs"]
mod clock;
#[path = "support/data.rs"]
mod data;
#[path = "faults/death.rs"]
mod death;
#[path = "faults/disk.rs"]
mod disk;
#[path = "support/engines.rs"]
mod engines;
#[path = "faults/kill.rs"]
mod kill;
#[path = "faults/load.rs"]
mod load;
#[path = "faults/lock.rs"]
mod lock;
#[path = "faults/power.rs"]
mod power;
#[path = "support/preload.rs"]
mod preload;
#[path = "support/process.rs"]
mod process;
#[path = "faults/stop.rs"]
mod stop;
