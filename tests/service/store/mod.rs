//! The promises of the store, on each engine.

mod audit;
mod audited_fields;
mod browser_sessions;
mod idempotency;
mod job_sessions;
mod opening;
mod parameter_sets;
mod rows;
mod transactions;
mod verify;
