//! Ready arms: the entries of the library, and the lists that are answered.

use crate::wire::robot::RobotBody;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A ready arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModel {
    /// Opaque identifier.
    pub id: String,
    /// The maker.
    pub maker: String,
    /// The maker's name of the type.
    pub name: String,
    /// Other names under which it is found.
    pub also: Vec<String>,
    /// What the pendant calls the joints, in order.
    pub joints: Vec<String>,
    /// The body of `POST /v1/robots`: nominal links, joint limits, and the joint map from the controller's values to the model's.
    pub robot: RobotBody,
    /// Where the base frame is.
    pub base: String,
    /// Where the flange frame is.
    pub flange: String,
    /// Where zeros, directions and couplings of the joints come from; `unknown` where no source says it.
    pub joint_map_source: String,
    /// Where the numbers come from. The first one is the entry's; the others were compared with it.
    pub sources: Vec<RobotModelSource>,
    /// What to know before use: differences between the sources, and what is not stated.
    pub notes: Vec<String>,
}

/// A source of an entry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelSource {
    /// Repository and model, or document and table.
    pub title: String,
    /// Its form.
    pub kind: RobotModelSourceKind,
    /// File of the public descriptions with which the tests compare the entry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub document: Option<String>,
    /// Its link that is the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_link: Option<String>,
    /// Its link that is the flange.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_link: Option<String>,
    /// Largest distance between the flanges of entry and source over random postures, mm; with tables up to where their base stands and how
    /// their flange is turned about its axis.
    pub largest_difference_mm: f64,
    /// Why they differ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
}

/// Form of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotModelSourceKind {
    /// A URDF, read by the tests.
    Urdf,
    /// A URDF or xacro, its numbers typed from the text.
    UrdfText,
    /// A table of Denavit-Hartenberg parameters.
    Table,
}

/// A ready arm in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelSummary {
    /// Opaque identifier.
    pub id: String,
    /// The maker.
    pub maker: String,
    /// The maker's name of the type.
    pub name: String,
    /// Number of joints.
    pub n_joints: usize,
    /// Number of sources that agree or whose differences are named.
    pub n_sources: usize,
}

/// Ready arms, by maker and name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RobotModelPage {
    /// The arms of this page.
    pub items: Vec<RobotModelSummary>,
    /// Pass it as `cursor` to get the next page; null on the last one.
    #[schema(required)]
    pub next_cursor: Option<String>,
    /// Number of arms on all pages.
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
