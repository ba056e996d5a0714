//! What the store promises, on each engine.

#[path = "store/audit.rs"]
mod audit;
#[path = "support/engines.rs"]
mod engines;
#[path = "support/fixtures.rs"]
mod fixtures;
#[path = "store/group_commit.rs"]
mod group_commit;
#[path = "store/idempotency.rs"]
mod idempotency;
#[path = "store/noted.rs"]
mod noted;
#[path = "store/opening.rs"]
mod opening;
#[path = "store/parameter_sets.rs"]
mod parameter_sets;
#[path = "store/rows.rs"]
mod rows;
#[path = "store/verify.rs"]
mod verify;
