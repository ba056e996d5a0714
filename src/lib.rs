//! kincal: kinematic calibration of industrial robots, as a pure numeric core and a thin service around it.
//!
//! Core (no IO, no async, no clock, no unseeded randomness): [`kinematics`], [`solvers`], [`measurement`],
//! [`frames`], [`identification`], [`compensation`], [`planning`], [`exchange`], [`calibration`]. Service: [`wire`], [`operations`], [`store`],
//! [`release`], [`jobs`], [`report_page`], [`http`], [`cli`], [`config`], [`telemetry`].
//! `ARCHITECTURE.md` has the map and the reasons; `tests/architecture/main.rs` checks which module may use which.

// The core: clippy.toml lists the float functions that it may not use.
#[warn(clippy::disallowed_methods)]
pub mod calibration;
#[warn(clippy::disallowed_methods)]
pub mod compensation;
#[warn(clippy::disallowed_methods)]
pub mod exchange;
#[warn(clippy::disallowed_methods)]
pub mod frames;
#[warn(clippy::disallowed_methods)]
pub mod identification;
#[warn(clippy::disallowed_methods)]
pub mod kinematics;
#[warn(clippy::disallowed_methods)]
pub mod measurement;
#[warn(clippy::disallowed_methods)]
pub mod planning;
#[warn(clippy::disallowed_methods)]
pub mod solvers;

pub mod cli;
pub mod config;
pub mod http;
pub mod jobs;
pub mod operations;
pub mod release;
pub mod report_page;
pub mod store;
pub mod telemetry;
pub mod wire;
