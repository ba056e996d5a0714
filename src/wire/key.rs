//! Permissions of API keys.

use crate::wire::names;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

names! {
    /// A permission of an API key.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
    #[serde(rename_all = "snake_case")]
    pub enum Scope {
        /// Read everything except keys, and calculate without storing.
        Read = "read",
        /// Store, edit and archive robots and measurement sets.
        Upload = "upload",
        /// Post and cancel jobs.
        Identify = "identify",
        /// Release and withdraw parameter sets.
        Release = "release",
        /// Everything, including the management of keys.
        Admin = "admin",
    }
}

impl Scope {
    /// The scope with this name.
    pub fn parse(name: &str) -> Option<Self> {
        serde_json::from_value(name.into()).ok()
    }
}

/// The permissions of the API key of a request, without the key itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeyAnswer {
    /// Id of the key; `anonymous` if the server needs no key.
    pub id: String,
    /// Its name; absent if the server needs no key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// `read`, `upload`, `identify`, `release`, `admin`. `admin` includes all others.
    #[schema(value_type = Vec<String>)]
    pub scopes: Vec<Scope>,
    /// Ids of the robots that the key is limited to; null for all robots.
    #[schema(required)]
    pub robots: Option<Vec<String>>,
}
