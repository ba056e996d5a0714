//! Errors of exports.

use crate::wire::issue::Invalid;

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The robot cannot be exported in this format, or the given URDF cannot be used.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The exported text reads back as a different robot. This is a defect of kincal.
    #[error("the {format} export does not read back: {cause}")]
    ReadBack {
        /// The format.
        format: &'static str,
        /// The difference.
        cause: String,
    },
}
