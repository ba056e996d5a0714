//! Library of robot models: its entries, and the answers that list them.

use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An entry of the library of robot models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModel {
    /// Opaque identifier.
    pub id: String,
    /// The manufacturer.
    pub maker: String,
    /// The manufacturer's name of the model.
    pub name: String,
    /// Other names under which the search finds it.
    pub also: Vec<String>,
    /// Names of the joints on the teach pendant, in order.
    pub joints: Vec<String>,
    /// The body for `POST /v1/robots`: nominal links, joint limits, and the joint map from the controller's joint values to those of the model.
    pub robot: RobotBody,
    /// Description of the base frame.
    pub base: String,
    /// Description of the flange frame.
    pub flange: String,
    /// Source of the zeros, directions and couplings of the joints; `unknown` if no source states them.
    pub joint_map_source: String,
    /// Sources of the numbers. The numbers of the entry come from the first source; the others were compared with it.
    pub sources: Vec<RobotModelSource>,
    /// Notes for the user: differences between the sources, and missing information.
    pub notes: Vec<String>,
}

/// A source of a robot model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelSource {
    /// Repository and model, or document and table, of the source.
    pub title: String,
    /// Format of the source.
    pub kind: RobotModelSourceKind,
    /// File with the public description that the tests compare the entry with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub document: Option<String>,
    /// The link of the description that is the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_link: Option<String>,
    /// The link of the description that is the flange.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_link: Option<String>,
    /// Largest distance between the flange positions of the entry and of the source over random postures, mm. For tables, differences in the position
    /// of the base and in the rotation of the flange about its axis are not counted.
    pub largest_difference_mm: f64,
    /// Why the entry and the source differ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
}

/// Format of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotModelSourceKind {
    /// A URDF file, which the tests parse.
    Urdf,
    /// A URDF or xacro file, from whose text the numbers were copied by hand.
    UrdfText,
    /// A table of Denavit-Hartenberg parameters.
    Table,
}

/// A robot model in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelSummary {
    /// Opaque identifier.
    pub id: String,
    /// The manufacturer.
    pub maker: String,
    /// The manufacturer's name of the model.
    pub name: String,
    /// Number of joints.
    pub n_joints: usize,
    /// Number of sources that agree with the entry, or whose differences are explained.
    pub n_sources: usize,
}

/// A page of robot models, sorted by manufacturer and name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelPage {
    /// The robot models of this page.
    pub items: Vec<RobotModelSummary>,
    /// Cursor to pass as `cursor` to get the next page; null on the last page.
    #[schema(required)]
    pub next_cursor: Option<String>,
    /// Number of robot models on all pages.
    pub total: usize,
}

impl From<&RobotModel> for RobotModelSummary {
    fn from(model: &RobotModel) -> Self {
        Self {
            id: model.id.clone(),
            maker: model.maker.clone(),
            name: model.name.clone(),
            n_joints: model.joints.len(),
            n_sources: model.sources.len(),
        }
    }
}
