//! One page of a list.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most items one page holds; keeps an answer well below a megabyte.
pub const MAX_PAGE: u32 = 200;
/// Items on a page when `limit` is not given.
pub const DEFAULT_PAGE: u32 = 50;

/// One page of a list, newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Page<T> {
    /// The items.
    pub items: Vec<T>,
    /// Pass it as `cursor` to get the next page; null on the last one.
    #[schema(required)]
    pub next_cursor: Option<String>,
}
