//! Import of robots from URDF files and tables of parameters.

use crate::wire::frames::Transform;
use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Format of a robot's description.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ImportFormat {
    /// A URDF file with all xacro macros expanded.
    Urdf,
    /// A table of parameters in the distal (standard) Denavit-Hartenberg convention: Rz(q + theta)·Dz(d)·Dx(a)·Rx(alpha).
    Dh,
    /// A table of parameters in Craig's (modified) convention, which kincal itself uses: Rx(alpha)·Dx(a)·Rz(q + theta)·Dz(d).
    Mdh,
}

/// An imported robot, ready for `POST /v1/robots`, and the transformations that its links cannot represent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ImportAnswer {
    /// The robot.
    pub robot: RobotBody,
    /// Names of the joints, if the description has any.
    pub joints: Vec<String>,
    /// Pose of the robot's base frame in the root frame of the description; usually the identity.
    pub t_root_base: Transform,
    /// Pose of the tip frame of the description in the robot's flange frame; often the identity.
    pub t_flange_tip: Transform,
    /// Largest position difference between the imported robot and the description over random configurations, mm.
    pub largest_difference_mm: f64,
    /// The URDF link at which the arm begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<String>,
    /// The URDF link at which the arm ends.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip: Option<String>,
    /// URDF links between root and tip that are rigidly attached to the previous link. Their transformations are contained in the parameters of the
    /// imported links.
    #[serde(default)]
    pub fixed_frames: Vec<String>,
    /// URDF links that are not between root and tip. They are not part of the imported robot.
    #[serde(default)]
    pub skipped_frames: Vec<String>,
}

/// Rounding of the numbers of an imported robot.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ImportDigits {
    /// Keep the numbers of the description exactly: 1.5708 rad becomes 90.0002°.
    #[default]
    Exact,
    /// Restore rounded angles: an angle that is a rounded multiple of 90° becomes exactly that multiple.
    Source,
}
