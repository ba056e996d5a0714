//! The promises of the store, on each engine.

mod audit;
mod idempotency;
mod noted;
mod opening;
mod parameter_sets;
mod rows;
mod transactions;
mod verify;
