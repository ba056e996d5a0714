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
    /// Its name in requests, in reports and on the command line.
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

/// What happened to the robot before a quick check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum After {
    /// It ran into something: joint zeros, base and tool are suspected first.
    Collision,
    /// Joints were mastered anew: joint zeros are suspected first.
    Mastering,
    /// A motor or an encoder was exchanged: joint zeros are suspected first.
    Motor,
}

/// Whether the released set still holds, as far as a quick check can tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CheckVerdict {
    /// The poses fit the set, and would have shown a change that matters.
    Holds,
    /// The robot, its base or its tool has changed.
    Changed,
    /// The poses fit the set, and might not have shown a change that matters; or the set has no stated uncertainty.
    CannotTell,
}
