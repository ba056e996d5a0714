//! What the queue and its workers promise, on each engine.

#[path = "jobs/computations.rs"]
mod computations;
#[path = "support/engines.rs"]
mod engines;
#[path = "support/fixtures.rs"]
mod fixtures;
#[path = "jobs/pool.rs"]
mod pool;
#[path = "jobs/queue.rs"]
mod queue;
#[path = "jobs/signals.rs"]
mod signals;
#[path = "jobs/worker.rs"]
mod worker;
