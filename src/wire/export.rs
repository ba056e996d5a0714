//! Formats and documents of exports.

use crate::exchange::refit::Refit;
use crate::wire::angle::to_radians;
use crate::wire::parameter_set::{ParameterSetContent, Provenance};
use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Format of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExportFormat {
    /// The nominal robot and the identified parameters; `kincal compensate` reads it.
    #[default]
    Json,
    /// The same document in YAML.
    Yaml,
    /// One row per link.
    Csv,
    /// A description for simulation and planning.
    Urdf,
    /// Joint origins as the drivers of Universal Robots read them; six joints.
    UrKinematics,
    /// Joint offsets for controllers that accept nothing else.
    Mastering,
}

/// Treatment of Hayati's beta.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BetaChoice {
    /// Links with beta.
    #[default]
    Keep,
    /// Links with beta 0 that are nearest over the workspace, and their remaining error.
    Refit,
}

/// The nominal robot and what was identified, in one document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ExportDocument {
    /// The parameter set.
    pub parameter_set_id: String,
    /// The nominal robot, as it was uploaded.
    pub robot: RobotBody,
    /// The identified parameters.
    #[serde(flatten)]
    pub content: ParameterSetContent,
    /// With `beta=refit`: distance of the tool by these links from the tool by the identified ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remaining_error_mm: Option<RemainingError>,
    /// Its provenance, and warnings.
    #[serde(flatten)]
    pub provenance: Provenance,
}

/// Distance of points 100 mm from the flange's origin from the same points by the identified links, over the workspace.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RemainingError {
    /// Mean, mm.
    pub mean: f64,
    /// Largest, mm.
    pub max: f64,
}

/// Joint offsets for a controller that accepts nothing else.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MasteringDocument {
    /// One per joint.
    pub joints: Vec<MasteringOffset>,
    /// Error of the tool that remains with them.
    pub remaining_error_mm: RemainingError,
}

/// JSON exports: the document with `format=json`, the offsets with `format=mastering`.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum ExportAnswer {
    /// `format=json`.
    Document(Box<ExportDocument>),
    /// `format=mastering`.
    Mastering(MasteringDocument),
}

/// Offset to add to a joint's value, in the controller's own sign: where the controller shows q, it should show q + offset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MasteringOffset {
    /// 1-based.
    pub joint: usize,
    /// Degrees.
    pub offset_deg: f64,
    /// False for the first and the last joint: positions cannot distinguish their offsets from the pose of base and tool.
    pub determined: bool,
}

impl MasteringDocument {
    /// The offsets, rad.
    pub fn offsets_rad(&self) -> Vec<f64> {
        self.joints
            .iter()
            .map(|joint| to_radians(joint.offset_deg))
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
