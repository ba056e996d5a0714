//! The REST interface, driven over loopback as a cell PC drives it.

mod auth;

mod bounds;
mod cell_pc;
mod check_robot;
mod closed_loop;
mod command_line;
mod compensate;
mod contract;
mod corrections;
mod export;
mod history;
mod hostile_names;
mod hosts;
mod idempotency;
mod jobs;
mod lost_connections;
mod matrix;
mod measurement_sets;
mod metrics;
mod misfits;
mod parameter_sets;
mod pose_plans;
mod poses;
mod problems;
mod release;
mod report_page;
mod residual_networks;
mod robots;
mod secrets;
mod sessions;
mod suspicions;
mod tls;
mod tools;
mod tutorial;
