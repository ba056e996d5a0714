//! Errors of exports.

use crate::wire::issue::Invalid;

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The robot or the URDF cannot be written in this format.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The text reads back as another robot: a defect of kincal.
    #[error("the {format} export does not read back: {cause}")]
    ReadBack {
        /// The format.
        format: &'static str,
        /// The difference.
        cause: String,
    },
}
