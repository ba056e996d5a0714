//! Whether points and a parameter set fit together.

use serde::Deserialize;

/// Whether points fit the robot and the parameter set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// The points fit the robot and the set.
    Fits,
    /// The set is far off at points that fit the robot or the set's own identification. This is evidence against the set.
    SetFarOff,
    /// The points do not fit the robot, so they are no evidence for or against any set.
    DoesNotFit,
}

impl Fit {
    /// The fit, if the set is far off at a run of successive configurations (`has_run`).
    pub fn with_run(self, has_run: bool) -> Self {
        match self {
            Self::Fits if has_run => Self::SetFarOff,
            other => other,
        }
    }

    /// Its name in the database.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fits => "fits",
            Self::SetFarOff => "set_far_off",
            Self::DoesNotFit => "does_not_fit",
        }
    }
}
