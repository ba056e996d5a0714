//! Ids in requests.

use crate::wire::issue::Invalid;

/// Maximum length of a text that is looked up as an id. The ids of this service have 36 characters.
pub(super) const MAX_ID: usize = 100;

/// Whether a text may be an id of this service. Other texts are not looked up, because PostgreSQL does not accept U+0000 and a long text costs time.
pub fn is_plausible(id: &str) -> bool {
    id.len() <= MAX_ID
        && id
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// Refusal of an id that does not belong to this robot. The answer is the same whether or not the id belongs to another robot.
pub fn unknown(at: &str, what: &str) -> Invalid {
    Invalid::at(
        at,
        "unknown_reference",
        format!("this robot has no {what} with this id"),
    )
}

/// Refuses a text that cannot be an id. The answer is the same as for an unknown id.
pub fn check(at: &str, id: &str, what: &str) -> Result<(), Invalid> {
    if is_plausible(id) {
        Ok(())
    } else {
        Err(unknown(at, what))
    }
}
