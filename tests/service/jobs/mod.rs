//! What the queue and its workers promise, on each engine.

mod computations;
mod pool;
mod queue;
mod signals;
mod upgrade;
mod worker;
