//! The JSON types of `openapi.yaml` and their conversion to and from the types of the core.
//!
//! Angles are in degrees here and in radians in the core. The names of fields end in their unit. The conversions check all
//! values, so values of the core's types are valid.

pub mod bounds;
pub mod canonical;
pub mod check;
pub mod columns;
pub mod compensate;
pub mod content_type;
pub mod corrected_program;
pub mod corrections;
pub mod estimate;
pub mod export;
pub mod frames;
pub mod history;
pub mod id;
pub mod import;
pub mod instrument;
pub mod issue;
pub mod job;
pub mod job_answer;
mod joint_map;
pub mod json;
pub mod key;
pub mod measurement;
pub mod multipart;
pub mod named_frame;
mod names;
pub mod network;
pub mod options;
pub mod overview;
pub mod page;
pub mod parameter_set;
pub mod parameters;
pub mod point;
pub mod policy;
pub mod pose_plan;
pub mod posture;
pub mod predict;
pub mod prior;
pub mod problem;
mod reason;
pub mod reference;
pub mod release;
pub mod report;
pub mod report_shape;
pub mod report_summary;
pub mod robot;
pub mod robot_model;
pub mod robot_patch;
pub mod safetensors;
pub mod session_record;
pub mod sessions;
pub mod suspicion;
pub mod table_preview;
pub mod table_upload;
mod target;
pub mod time;
pub mod tool;
pub mod trend;
pub mod understood;
pub mod verification;
pub mod warning;
pub mod workbook;

pub(crate) use names::names;

pub use issue::{Invalid, Issue};
pub use problem::Problem;
