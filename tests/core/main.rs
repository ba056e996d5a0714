//! The numeric core: kinematics, solvers, identification, corrections, compensation, planning, exchange, calibration.

mod alignment;
mod axis_reflector;
mod cartesian;
mod central_differences;
mod changes;
mod compensation;
mod corrections;
mod drift;
mod estimate;
mod exchange;
mod few_poses;
mod final_fit;
mod follow_ups;
mod frames;

mod identification;
mod kinematics;
mod measurement;
mod network_starts;
mod noise;
mod numeric_solvers;
mod paper_pins;
mod partial;
mod planning;
mod poses;
mod priors;
mod programs;
mod quick_check;
mod real_robots;
mod repeatability;
mod robot_models;
mod scale;
mod screening;
mod sessions;
#[path = "../support/mod.rs"]
mod support;
mod tables;
mod two_files;
mod uncertainty;
mod work_frames;
mod workbooks;

use support::{
    bad_campaigns, data, drifts, joint_errors, real_robot, robots, simulation, trackers,
};
