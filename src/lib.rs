//! kincal: kinematic calibration of industrial robots, as a pure numeric core and a thin service around it.
//!
//! The core is the package `kincal-core` in `core/`; its modules are re-exported here: [`kinematics`], [`solvers`], [`measurement`],
//! [`frames`], [`identification`], [`compensation`], [`planning`], [`exchange`], [`calibration`]. This package is the service: [`wire`],
//! [`operations`], [`store`], [`release`], [`jobs`], [`report_page`], [`http`], [`cli`], [`config`], [`telemetry`].
//! `ARCHITECTURE.md` has the map and the reasons; `tests/architecture/main.rs` checks which module may use which.

pub use kincal_core::{
    calibration, compensation, exchange, frames, identification, kinematics, measurement, planning,
    solvers,
};

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
