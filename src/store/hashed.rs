//! Bytes or a text with their hash.

use crate::wire::canonical::sha256_hex;

/// Content with its SHA-256. Uploads, reports and networks are hashed when this value is made, before a transaction begins, because hashing 32 MiB
/// takes about 50 ms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hashed<T> {
    content: T,
    sha256: String,
}

impl<T: AsRef<[u8]>> From<T> for Hashed<T> {
    fn from(content: T) -> Self {
        Self {
            sha256: sha256_hex(content.as_ref()),
            content,
        }
    }
}

impl<T> Hashed<T> {
    /// The content.
    pub fn content(&self) -> &T {
        &self.content
    }

    /// Its SHA-256, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }
}
