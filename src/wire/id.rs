//! Ids that clients name.

use crate::wire::issue::Invalid;

/// Longest id that is looked up; ours have 36 characters.
pub(super) const MAX_ID: usize = 100;

/// Whether a text may be one of our ids. What cannot be one is not looked up: PostgreSQL takes no U+0000, and a long one is only work.
pub fn is_plausible(id: &str) -> bool {
    id.len() <= MAX_ID
        && id
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// What the request names and the robot does not have, whether there is such a thing or not.
pub fn unknown(at: &str, what: &str) -> Invalid {
    Invalid::at(
        at,
        "unknown_reference",
        format!("this robot has no {what} with this id"),
    )
}

/// Refuses what cannot be an id, as what does not exist.
///
/// # Errors
/// [`Invalid`]: `unknown_reference`.
pub fn check(at: &str, id: &str, what: &str) -> Result<(), Invalid> {
    if is_plausible(id) {
        Ok(())
    } else {
        Err(unknown(at, what))
    }
}
