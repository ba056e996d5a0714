//! One page of a list.

use crate::wire::names;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Maximum number of items on a page. It keeps an answer well below a megabyte.
pub const MAX_PAGE: u32 = 200;
/// Number of items on a page if `limit` is not given.
pub const DEFAULT_PAGE: u32 = 50;

/// One page of a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Page<T> {
    /// The items.
    pub items: Vec<T>,
    /// Cursor to pass as `cursor` to get the next page; null on the last page.
    #[schema(required)]
    pub next_cursor: Option<String>,
    /// Number of items on all pages.
    #[schema(minimum = 0)]
    pub total: i64,
}

/// Order of a list. A `-` at the beginning of the value means descending order.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
pub enum Sort {
    /// Newest first.
    #[default]
    #[serde(rename = "-created_at")]
    #[value(name = "-created_at")]
    Newest,
    /// Oldest first.
    #[serde(rename = "created_at")]
    #[value(name = "created_at")]
    Oldest,
    /// By name, ascending.
    #[serde(rename = "name")]
    #[value(name = "name")]
    Name,
    /// By name, descending.
    #[serde(rename = "-name")]
    #[value(name = "-name")]
    NameDescending,
}

impl Sort {
    /// Whether the list is sorted by name.
    pub fn is_by_name(self) -> bool {
        matches!(self, Self::Name | Self::NameDescending)
    }
}

names! {
    /// Whether a list contains archived items.
    #[derive(
        Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
    )]
    #[serde(rename_all = "snake_case")]
    #[value(rename_all = "snake_case")]
    pub enum ArchivedFilter {
        /// Only items that are not archived.
        #[default]
        False = "false",
        /// Only archived items.
        True = "true",
        /// All items, archived or not.
        All = "all",
    }
}
