//! Formats and documents of exports.

use crate::exchange::refit::Refit;
use crate::wire::compensate::ErrorFrame;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::RobotBody;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Format of an export.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ExportFormat {
    /// The nominal robot and the identified parameters; `kincal compensate` reads it.
    #[default]
    Json,
    /// The same document in YAML.
    Yaml,
    /// One row per link.
    Csv,
    /// A URDF robot description, for simulation and planning.
    Urdf,
    /// Joint origins in the format of the Universal Robots drivers. Only for robots with six joints.
    UrKinematics,
    /// Joint offsets only, for controllers that accept no other parameters.
    Mastering,
}

/// Treatment of the Hayati parameter beta.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BetaChoice {
    /// Export links with beta.
    #[default]
    Keep,
    /// Export links with beta = 0 that are fitted to the identified robot over the workspace, and state their remaining error.
    Refit,
}

/// The nominal robot and the identified parameters, in one document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExportDocument {
    /// The parameter set.
    pub parameter_set_id: String,
    /// The nominal robot, as it was uploaded.
    pub robot: RobotBody,
    /// The identified parameters.
    #[serde(flatten)]
    pub content: ParameterSetContent,
    /// With `beta=refit`: distance between the tool position of these links and that of the identified links.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remaining_error_mm: Option<RemainingError>,
    /// Its provenance, and warnings.
    #[serde(flatten)]
    pub provenance: Provenance,
}

/// Position error over the workspace, for points 100 mm from the flange's origin: distance between their positions computed with the exported and
/// with the identified parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RemainingError {
    /// Mean, mm.
    pub mean: f64,
    /// Largest, mm.
    pub max: f64,
}

/// Joint offsets, for a controller that accepts no other parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MasteringDocument {
    /// One offset for each joint.
    pub joints: Vec<MasteringOffset>,
    /// Error of the tool that remains with these offsets, in `frame`. The rotation of the tool about the last axis is not part of it.
    pub remaining_error_mm: RemainingError,
    /// The frame for which the offsets are optimal: `measuring` if positions were measured in the base frame and the base stands there. With
    /// `robot_base` the error applies after the base frame was moved to where link 1 of the identified robot begins.
    pub frame: ErrorFrame,
}

/// A JSON export: the document with `format=json`, or the offsets with `format=mastering`.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum ExportAnswer {
    /// `format=json`.
    Document(Box<ExportDocument>),
    /// `format=mastering`.
    Mastering(MasteringDocument),
}

/// Offset to add to a joint's value, with the sign of the controller: where the controller displays q, it should display q + offset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MasteringOffset {
    /// 1-based.
    pub joint: usize,
    /// Degrees.
    pub offset_deg: f64,
    /// False for the last joint, because position measurements cannot distinguish its offset from the pose of the tool. False for the first joint with
    /// `frame: robot_base`, because its offset cannot be distinguished from the pose of the base. Positions in the base frame determine it.
    pub determined: bool,
}

impl MasteringDocument {
    /// The offsets, rad.
    pub fn offsets_rad(&self) -> Vec<f64> {
        self.joints
            .iter()
            .map(|joint| joint.offset_deg.to_radians())
            .collect()
    }
}

impl From<&Refit> for RemainingError {
    fn from(refit: &Refit) -> Self {
        Self {
            mean: refit.mean_mm,
            max: refit.max_mm,
        }
    }
}
