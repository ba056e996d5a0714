//! Ids in requests.

use crate::wire::issue::Invalid;

/// Longest text that is looked up as an id. The service's ids have 36 characters.
pub(super) const MAX_ID: usize = 100;

/// Whether a text may be an id of this service. Other texts are not looked up: PostgreSQL accepts no U+0000, and a long text costs time.
pub fn is_plausible(id: &str) -> bool {
    id.len() <= MAX_ID
        && id
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// Refusal of an id that this robot does not have. The answer is the same whether or not another robot has it.
pub fn unknown(at: &str, what: &str) -> Invalid {
    Invalid::at(
        at,
        "unknown_reference",
        format!("this robot has no {what} with this id"),
    )
}

/// Refuses a text that cannot be an id, with the answer for an unknown id.
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
