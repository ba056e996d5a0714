//! Which parameters exist, and where options come from.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which parameters exist.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Model {
    /// The paper's: four per link, base known, target on the flange axis.
    Paper,
    /// Base pose, targets, and all five numbers of every link; priors settle what positions cannot tell apart.
    #[default]
    Complete,
}

impl Model {
    /// Its name in requests, in reports and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Complete => "complete",
        }
    }
}

/// Default values of options.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Preset {
    /// Ours.
    #[default]
    Default,
    /// The paper's, to the letter.
    Paper,
}

impl Preset {
    /// Its name in requests, in reports and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Paper => "paper",
        }
    }
}
