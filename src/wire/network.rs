//! Metadata of a stored network.

use crate::wire::job::{Model, Preset};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Kind of a network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NetworkKind {
    /// Link parameters → corrected link parameters: it moves the first swarm of `bpnn_pso` (section 5 of the paper).
    #[default]
    LinkParameters,
    /// Joint values → position errors that remain after links and physical corrections: the last of the corrections.
    Residual,
}

/// A trained network without its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NetworkAnswer {
    /// Opaque identifier; a job takes it as `network_id` or, of kind residual, as `residual_network_id`.
    pub id: String,
    /// Its kind.
    pub kind: NetworkKind,
    /// The robot it was trained for.
    pub robot_id: String,
    /// The job that trained it.
    pub job_id: String,
    /// The model that was identified.
    pub model: Model,
    /// The preset it belongs to.
    pub preset: Preset,
    /// Names of inputs and outputs, in order; of a residual network the inputs `q_1`, `q_2`, …, its outputs are x, y and z of the base frame.
    pub parameter_names: Vec<String>,
    /// Hidden nodes.
    pub n_hidden: usize,
    /// Mean squared training error, in units of the search box; of a residual network, of the points that it was trained on with all corrections, mm².
    pub training_error: f64,
    /// Mean squared error on the particles held out, in units of the search box; of a residual network, the cross-validated error, mm².
    pub validation_error: f64,
    /// SHA-256 of the tensors, in the order of their names.
    pub sha256: String,
    /// When it was trained: RFC 3339, UTC.
    pub created_at: String,
    /// When it was archived: RFC 3339, UTC. No job chooses it then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
}
