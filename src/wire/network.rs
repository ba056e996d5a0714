//! What is known of a stored network.

use crate::wire::job::{Model, Preset};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A trained network without its weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NetworkAnswer {
    /// Opaque identifier; a job takes it as `network_id`.
    pub id: String,
    /// The robot it was trained for.
    pub robot_id: String,
    /// The job that trained it.
    pub job_id: String,
    /// The model it belongs to.
    pub model: Model,
    /// The preset it belongs to.
    pub preset: Preset,
    /// Names of inputs and outputs, in order.
    pub parameter_names: Vec<String>,
    /// Hidden nodes.
    pub n_hidden: usize,
    /// Mean squared training error, in units of the search box.
    pub training_error: f64,
    /// Mean squared error on the particles held out, in units of the search box.
    pub validation_error: f64,
    /// SHA-256 of the tensors (see the weights' own documentation).
    pub sha256: String,
    /// When it was trained: RFC 3339, UTC.
    pub created_at: String,
}
