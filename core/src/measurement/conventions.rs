//! Conventions of a measurement file: the frame of its positions, its subsets, and its decimal mark.

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
    /// The instrument's own frame. The base pose and the positions of the targets on the flange are unknown.
    Instrument,
}

impl Frame {
    /// Its name in requests, in the database and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Base => "base",
            Self::Instrument => "instrument",
        }
    }
}

/// Which subset of a measurement set a point belongs to.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema,
)]
#[schema(as = SubsetName)]
#[serde(rename_all = "snake_case")]
pub enum Subset {
    /// The parameters are fitted to the point.
    Identify,
    /// The point is held out, and the parameters are scored on it.
    Verify,
}

/// Decimal mark of a CSV file.
// The decimal mark must be declared, because 1,234 is a valid number with both marks, but not the same number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Decimal {
    /// `12.5`; columns are separated by commas.
    #[default]
    Point,
    /// `12,5`; columns are separated by semicolons, as in exports of a German or French spreadsheet.
    Comma,
}
