//! Why there is no export.

use crate::wire::issue::Invalid;

/// Why there is no export.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The robot or the URDF cannot be written that way.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// What was written reads back as another robot: a fault of ours.
    #[error("the {format} export does not read back: {cause}")]
    ReadBack {
        /// The format.
        format: &'static str,
        /// How.
        cause: String,
    },
}
