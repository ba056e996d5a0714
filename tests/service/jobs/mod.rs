//! The promises of the queue and its workers, on each engine.

mod computations;
mod pool;
mod queue;
mod signals;
mod upgrade;
mod worker;
