//! The promises of the queue and its workers, on each engine.

mod queue;
mod upgrade;
mod worker;
