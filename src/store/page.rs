//! Pages of lists, newest first. Items that existed at the first page appear exactly once, even if others are added meanwhile.

use crate::wire::page::{self, MAX_PAGE};

/// Request for a page of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageRequest {
    /// Most items on the page; clamped to 1..=[`MAX_PAGE`].
    pub limit: u32,
    /// End of the page before; none for the first page.
    pub cursor: Option<Cursor>,
}

/// One page of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T> {
    /// The items, newest first.
    pub items: Vec<T>,
    /// Cursor of the next page; none on the last page.
    pub next_cursor: Option<Cursor>,
}

impl<T> Page<T> {
    /// The page as an answer.
    ///
    /// # Errors
    /// Those of `convert`.
    pub fn into_answer<U, E>(
        self,
        convert: impl FnMut(T) -> Result<U, E>,
    ) -> Result<page::Page<U>, E> {
        Ok(page::Page {
            items: self
                .items
                .into_iter()
                .map(convert)
                .collect::<Result<_, _>>()?,
            next_cursor: self.next_cursor.map(|cursor| cursor.to_string()),
        })
    }
}

/// The last item of a page. Clients get its text and send it back unread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cursor {
    created_at_ms: i64,
    id: String,
}

/// The text is not a cursor of this service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this is not a cursor of this service")]
pub struct InvalidCursor;

impl std::fmt::Display for Cursor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{}", self.created_at_ms, self.id)
    }
}

impl std::str::FromStr for Cursor {
    type Err = InvalidCursor;

    fn from_str(text: &str) -> Result<Self, InvalidCursor> {
        let (created_at_ms, id) = text.split_once('-').ok_or(InvalidCursor)?;
        let is_id = !id.is_empty() && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        match created_at_ms.parse() {
            Ok(created_at_ms) if is_id => Ok(Cursor {
                created_at_ms,
                id: id.to_owned(),
            }),
            _ => Err(InvalidCursor),
        }
    }
}

impl Default for PageRequest {
    fn default() -> Self {
        PageRequest {
            limit: MAX_PAGE,
            cursor: None,
        }
    }
}

/// Bind values of a list query: rows before (`created_at_ms`, `id`), one more than fits on the page.
pub(crate) struct Keyset {
    pub(crate) created_at_ms: i64,
    pub(crate) id: String,
    pub(crate) limit: i64,
}

impl PageRequest {
    fn limit(&self) -> usize {
        self.limit.clamp(1, MAX_PAGE) as usize
    }

    pub(crate) fn keyset(&self) -> Keyset {
        let limit = self.limit() as i64 + 1;
        match self.cursor.clone() {
            Some(Cursor { created_at_ms, id }) => Keyset {
                created_at_ms,
                id,
                limit,
            },
            None => Keyset {
                created_at_ms: i64::MAX,
                id: String::new(),
                limit,
            },
        }
    }

    /// The page made of the rows of a query with [`PageRequest::keyset`].
    pub(crate) fn page<T>(&self, mut rows: Vec<T>, key: impl Fn(&T) -> (i64, &str)) -> Page<T> {
        let more = rows.len() > self.limit();
        rows.truncate(self.limit());
        let next_cursor = rows.last().filter(|_| more).map(|last| {
            let (created_at_ms, id) = key(last);
            Cursor {
                created_at_ms,
                id: id.to_owned(),
            }
        });
        Page {
            items: rows,
            next_cursor,
        }
    }
}
