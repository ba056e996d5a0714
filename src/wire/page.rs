//! One page of a list.

use crate::wire::names;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Most items one page holds; keeps an answer well below a megabyte.
pub const MAX_PAGE: u32 = 200;
/// Items on a page when `limit` is not given.
pub const DEFAULT_PAGE: u32 = 50;

/// One page of a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Page<T> {
    /// The items.
    pub items: Vec<T>,
    /// Pass it as `cursor` to get the next page; null on the last one.
    #[schema(required)]
    pub next_cursor: Option<String>,
    /// Number of items on all pages.
    #[schema(minimum = 0)]
    pub total: i64,
}

/// Order of a list. A name begins with `-` if the largest comes first.
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
    /// By name.
    #[serde(rename = "name")]
    #[value(name = "name")]
    Name,
    /// By name, from the last.
    #[serde(rename = "-name")]
    #[value(name = "-name")]
    NameDescending,
}

impl Sort {
    /// Whether it needs names.
    pub fn is_by_name(self) -> bool {
        matches!(self, Self::Name | Self::NameDescending)
    }
}

/// Which items a list has.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum ArchivedFilter {
    /// Those that are in use.
    #[default]
    False,
    /// Those that were archived.
    True,
    /// Both.
    All,
}

names!(ArchivedFilter { False = "false", True = "true", All = "all" });
