//! Code that the test binaries share.
#![allow(dead_code, unused_macros, reason = "each binary uses a part")]

pub mod app;
pub mod bad_campaigns;
pub mod computations;
pub mod data;
pub mod drifts;
pub mod engines;
pub mod fixtures;
pub mod joint_errors;
pub mod people;
pub mod preload;
pub mod process;
pub mod raw;
pub mod real_robot;
pub mod robots;
pub mod simulation;
pub mod trackers;
