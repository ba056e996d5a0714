//! The service: routes, command line, queue and store, on real databases.

mod api;
mod bad_input;
mod dangerous_uploads;
mod jobs;
mod real_binary;
mod store;
#[path = "../support/mod.rs"]
mod support;

use support::{
    app, computations, data, engines, fixtures, people, process, raw, real_robot, simulation,
    trackers,
};
