//! The JSON types of `openapi.yaml` and their conversion to and from the types of the core.
//!
//! Angles are in degrees here and in radians in the core. The names of fields end in their unit. The conversions check all
//! values, so values of the core's types are valid.

// What all documents share: JSON, issues, pages, times, and the bounds of the contract.
pub mod bounds;
pub mod canonical;
pub mod content_type;
pub mod decimals;
pub mod id;
pub mod issue;
pub mod json;
pub mod multipart;
mod names;
pub mod page;
pub mod problem;
pub mod time;
pub mod warning;

// Robots, and the documents that they have under a name.
pub mod import;
mod joint_map;
pub mod key;
pub mod named_frame;
pub mod overview;
pub mod policy;
pub mod reference;
pub mod robot;
pub mod robot_model;
pub mod robot_patch;
pub mod tool;

// Measurements, and the tables that contain them.
pub mod columns;
pub mod frames;
pub mod instrument;
pub mod measurement;
pub mod point;
pub mod points_csv;
pub mod session_record;
pub mod suspicion;
pub mod table_preview;
pub mod table_upload;
mod target;
pub mod understood;
pub mod workbook;

// Jobs and their reports.
pub mod estimate;
pub mod job;
pub mod job_answer;
pub mod network;
pub mod options;
pub mod parameters;
pub mod prior;
pub mod report;
pub mod report_shape;
pub mod report_summary;
pub mod safetensors;
pub mod sessions;

// Parameter sets, releases and computations.
pub mod compensate;
pub mod corrections;
pub mod export;
pub mod history;
pub mod parameter_set;
pub mod pose_plan;
pub mod posture;
pub mod predict;
pub mod release;
pub mod verification;

pub(crate) use names::names;

pub use issue::{Invalid, Issue};
pub use problem::Problem;
