//! Conventions of a measurement file: the frame of its positions, its two halves, and how it writes numbers.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The frame in which positions were measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Frame {
    /// The robot's base frame.
    Base,
    /// The instrument's own frame: base pose and target offsets are unknown.
    Instrument,
}

impl Frame {
    /// As it stands in requests, in the database and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Base => "base",
            Self::Instrument => "instrument",
        }
    }
}

/// Which half of a set a point belongs to.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
#[schema(as = SubsetName)]
#[serde(rename_all = "snake_case")]
pub enum Subset {
    /// The parameters are fitted to it.
    Identify,
    /// The parameters are scored on it.
    Verify,
}

/// How a CSV file writes its numbers.
// It has to be declared: 1,234 is a number in both, and not the same one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Decimal {
    /// `12.5`, columns separated by commas.
    #[default]
    Point,
    /// `12,5`, columns separated by semicolons, as a German or French spreadsheet exports.
    Comma,
}

impl Decimal {
    pub(super) fn separator(self) -> u8 {
        match self {
            Self::Point => b',',
            Self::Comma => b';',
        }
    }
}
