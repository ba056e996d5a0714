//! The REST interface, driven over loopback as a cell PC drives it.

#[path = "support/app.rs"]
mod app;
#[path = "support/engines.rs"]
mod engines;
#[path = "support/people.rs"]
mod people;
#[path = "support/raw.rs"]
mod raw;

#[path = "api/auth.rs"]
mod auth;
#[path = "support/real_robot.rs"]
mod real_robot;

#[path = "api/cell_pc.rs"]
mod cell_pc;
#[path = "api/closed_loop.rs"]
mod closed_loop;
#[path = "api/command_line.rs"]
mod command_line;
#[path = "api/compensate.rs"]
mod compensate;
#[path = "api/contract.rs"]
mod contract;
#[path = "api/corrections.rs"]
mod corrections;
#[path = "api/export.rs"]
mod export;
#[path = "api/history.rs"]
mod history;
#[path = "api/hostile_names.rs"]
mod hostile_names;
#[path = "api/idempotency.rs"]
mod idempotency;
#[path = "api/jobs.rs"]
mod jobs;
#[path = "api/lost_connections.rs"]
mod lost_connections;
#[path = "api/matrix.rs"]
mod matrix;
#[path = "api/measurement_sets.rs"]
mod measurement_sets;
#[path = "api/metrics.rs"]
mod metrics;
#[path = "api/parameter_sets.rs"]
mod parameter_sets;
#[path = "api/pose_plans.rs"]
mod pose_plans;
#[path = "api/problems.rs"]
mod problems;
#[path = "api/process.rs"]
mod process;
#[path = "api/release.rs"]
mod release;
#[path = "api/report_page.rs"]
mod report_page;
#[path = "api/residual_networks.rs"]
mod residual_networks;
#[path = "api/robots.rs"]
mod robots;
#[path = "api/secrets.rs"]
mod secrets;
#[path = "api/tls.rs"]
mod tls;
#[path = "api/tools.rs"]
mod tools;
#[path = "api/tutorial.rs"]
mod tutorial;
