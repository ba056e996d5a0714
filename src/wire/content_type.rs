//! Parameters in the content type of a CSV file: the decimal mark and the rotation convention. The content type is stored with the upload.

use crate::measurement::rotation_convention::CONVENTIONS;
use crate::measurement::{Decimal, RotationConvention};
use crate::wire::issue::Invalid;

/// Parameter of a content type that declares decimal commas. The parameter is stored with the upload, so that the stored bytes are parsed in the same
/// way again.
pub const DECIMAL_COMMA: &str = "decimal=comma";
/// Parameter of a content type that declares decimal points.
pub const DECIMAL_POINT: &str = "decimal=point";

/// Decimal mark that a content type declares, if any.
pub fn declared_decimal(content_type: &str) -> Option<Decimal> {
    let mut parameters = content_type.split(';').skip(1);
    parameters.find_map(|parameter| match parameter.trim() {
        text if text.eq_ignore_ascii_case(DECIMAL_COMMA) => Some(Decimal::Comma),
        text if text.eq_ignore_ascii_case(DECIMAL_POINT) => Some(Decimal::Point),
        _ => None,
    })
}

/// Parameter of a content type that declares the rotation convention of poses. It is stored with the upload, like [`DECIMAL_COMMA`].
const ROTATION: &str = "rotation=";

/// Adds a rotation convention to a content type.
pub fn with_rotation(content_type: &str, convention: RotationConvention) -> String {
    format!("{content_type}; {ROTATION}{convention}")
}

/// Rotation convention that a content type declares, if any.
pub fn declared_rotation(content_type: &str) -> Option<RotationConvention> {
    let mut parameters = content_type.split(';').skip(1).map(str::trim);
    parameters.find_map(|parameter| parameter.strip_prefix(ROTATION)?.parse().ok())
}

/// Parses the name of a rotation convention.
///
/// # Errors
/// [`Invalid`] with a list of the possible names.
pub fn rotation_convention(name: &str) -> Result<RotationConvention, Invalid> {
    name.parse().map_err(|_| {
        let shown: String = name.chars().take(40).collect();
        let detail = format!("{shown:?} is no convention of rotations; it is {CONVENTIONS}");
        Invalid::at("/rotation", "unknown_rotation", detail)
    })
}
