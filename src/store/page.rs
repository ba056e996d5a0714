//! Pages of lists. In a list that is sorted by creation time, items that existed when the first page was read appear exactly once, even if other
//! items are added in the meantime.

use crate::wire::canonical::hex;
use crate::wire::page::{self, Sort};

/// One page of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T> {
    /// The items, in the requested order.
    pub items: Vec<T>,
    /// Cursor of the next page; none on the last page.
    pub next_cursor: Option<Cursor>,
    /// Number of items on all pages.
    pub total: i64,
}

impl<T> Page<T> {
    /// Converts the page to an answer.
    pub fn into_answer<U, E>(self) -> Result<page::Page<U>, E>
    where
        U: for<'r> TryFrom<&'r T, Error = E>,
    {
        let items = self.items.iter().map(U::try_from);
        Ok(page::Page {
            items: items.collect::<Result<_, _>>()?,
            next_cursor: self.next_cursor.map(|cursor| cursor.to_string()),
            total: self.total,
        })
    }
}

/// Position of the last item of a page in the order of the list. Clients get the cursor as an opaque text and send it back unchanged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cursor {
    pub(super) sort: Sort,
    pub(super) key: CursorKey,
    pub(super) id: String,
}

/// The value that a list is sorted by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum CursorKey {
    CreatedAtMs(i64),
    Name(String),
}

/// The text is not a cursor of this service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this is not a cursor of this service")]
pub struct InvalidCursor;

/// Maximum length of a name in a cursor, bytes. A name has at most 200 characters of up to four bytes.
const MAX_NAME_BYTES: usize = 800;

/// First letter of the cursor text for each order. The order "newest first" has no letter.
const LETTERS: [(Sort, &str); 3] = [
    (Sort::Oldest, "a"),
    (Sort::Name, "n"),
    (Sort::NameDescending, "m"),
];

impl std::fmt::Display for Cursor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some((_, letter)) = LETTERS.iter().find(|(sort, _)| *sort == self.sort) {
            f.write_str(letter)?;
        }
        match &self.key {
            CursorKey::CreatedAtMs(at_ms) => write!(f, "{at_ms}-{}", self.id),
            CursorKey::Name(name) => write!(f, "{}-{}", hex(name.as_bytes()), self.id),
        }
    }
}

impl std::str::FromStr for Cursor {
    type Err = InvalidCursor;

    fn from_str(text: &str) -> Result<Self, InvalidCursor> {
        let found = LETTERS
            .iter()
            .find_map(|(sort, letter)| Some((*sort, text.strip_prefix(letter)?)));
        let (sort, rest) = found.unwrap_or((Sort::Newest, text));
        let (key, id) = rest.split_once('-').ok_or(InvalidCursor)?;
        let is_id = !id.is_empty() && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        let key = match sort.is_by_name() {
            false => key.parse().ok().map(CursorKey::CreatedAtMs),
            true => unhex(key).map(CursorKey::Name),
        };
        match key {
            Some(key) if is_id => Ok(Cursor {
                sort,
                key,
                id: id.to_owned(),
            }),
            _ => Err(InvalidCursor),
        }
    }
}

/// Decodes hexadecimal digits to UTF-8 text.
fn unhex(digits: &str) -> Option<String> {
    if digits.len() > 2 * MAX_NAME_BYTES || !digits.len().is_multiple_of(2) || !digits.is_ascii() {
        return None;
    }
    let bytes: Option<Vec<u8>> = (0..digits.len() / 2)
        .map(|i| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).ok())
        .collect();
    String::from_utf8(bytes?).ok()
}
