//! Metadata of a stored network.

use crate::wire::job::{Model, Preset};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Kind of a network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NetworkKind {
    /// Maps link parameters to corrected link parameters. It moves the first swarm of `bpnn_pso` (section 5 of the paper).
    #[default]
    LinkParameters,
    /// Maps joint values to the position errors that remain after the link parameters and the physical corrections. It is the last of the
    /// corrections.
    Residual,
}

/// A trained network without its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NetworkAnswer {
    /// Opaque identifier. A job takes it as `network_id`, or as `residual_network_id` if the kind is `residual`.
    pub id: String,
    /// Its kind.
    pub kind: NetworkKind,
    /// The robot that the network was trained for.
    pub robot_id: String,
    /// The job that trained it.
    pub job_id: String,
    /// The model that was identified.
    pub model: Model,
    /// The preset of the job.
    pub preset: Preset,
    /// Names of inputs and outputs, in order. For a residual network these are the inputs `q_1`, `q_2`, …; its outputs are x, y and z in the base
    /// frame.
    pub parameter_names: Vec<String>,
    /// Number of hidden nodes.
    pub n_hidden: usize,
    /// Mean squared training error, in units of the search box. For a residual network: mean squared error of the training points with all
    /// corrections, mm².
    pub training_error: f64,
    /// Mean squared error on the held-out particles, in units of the search box. For a residual network: the cross-validated mean squared error, mm².
    pub validation_error: f64,
    /// SHA-256 of the tensors in the order of their names, hexadecimal.
    pub sha256: String,
    /// When it was trained: RFC 3339, UTC.
    pub created_at: String,
    /// When it was archived: RFC 3339, UTC. Jobs do not choose an archived network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<String>,
}
