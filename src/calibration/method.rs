//! How a calibration is done: method, loss and corrections.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How the parameters are identified.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Method {
    /// The best we know for this set.
    #[default]
    Auto,
    /// Levenberg-Marquardt from nominal.
    LeastSquares,
    /// Particle swarm, cold.
    Pso,
    /// Particle swarm that the robot's network moves first.
    BpnnPso,
}

impl Method {
    /// As it stands in requests, reports and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::LeastSquares => "least_squares",
            Self::Pso => "pso",
            Self::BpnnPso => "bpnn_pso",
        }
    }
}

/// How a residual counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// |r|².
    Squares,
    /// Huber's.
    Huber,
    /// Tukey's biweight.
    Tukey,
}

/// Which points the delivered parameters are fitted to, after the held-out points were verified on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum FinalFit {
    /// All points of the upload.
    All,
    /// The identify subset alone: the delivered parameters are those that were verified.
    IdentifySubset,
}

/// What link parameters cannot say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[schema(as = Corrections)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum CorrectionsChoice {
    /// Links alone.
    Off,
    /// Those that win by cross-validation.
    Auto,
}
