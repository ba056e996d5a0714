//! Robots that are read from URDF files and tables.

use crate::wire::frames::Transform;
use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Format of a robot's description.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ImportFormat {
    /// A URDF, xacro expanded.
    Urdf,
    /// A table of the distal (standard) Denavit-Hartenberg convention: Rz(q + theta)·Dz(d)·Dx(a)·Rx(alpha).
    Dh,
    /// A table of Craig's (modified) convention, kincal's own: Rx(alpha)·Dx(a)·Rz(q + theta)·Dz(d).
    Mdh,
}

/// A robot for `POST /v1/robots`, and the transformations that its links cannot represent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ImportAnswer {
    /// The robot.
    pub robot: RobotBody,
    /// Names of the joints, if the description has any.
    pub joints: Vec<String>,
    /// Pose of the links' base in the description's root; usually the identity.
    pub t_root_base: Transform,
    /// Pose of the description's tip on the links' flange; often the identity.
    pub t_flange_tip: Transform,
    /// Largest difference between links and description over random configurations, mm.
    pub largest_difference_mm: f64,
    /// The link of the URDF in which the arm begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<String>,
    /// The link of the URDF at which the arm ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip: Option<String>,
    /// Links of the URDF on the way from root to tip that do not move against the one before: they are in the links' numbers.
    #[serde(default)]
    pub fixed_frames: Vec<String>,
    /// Links of the URDF that are not on the way: they are no part of the robot.
    #[serde(default)]
    pub skipped_frames: Vec<String>,
}

/// Digits of an imported robot's numbers.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ImportDigits {
    /// All digits of the description: 1.5708 rad is 90.0002°.
    #[default]
    Exact,
    /// What the description means: angles that are a rounded multiple of 90° are that multiple.
    Source,
}
