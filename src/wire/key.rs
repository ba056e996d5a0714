//! What a key may do.

use crate::wire::names;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Something that a key may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Read everything but keys, and predict.
    Read,
    /// Store robots, measurement sets and frames.
    Upload,
    /// Post and cancel jobs.
    Identify,
    /// Release and withdraw parameter sets.
    Release,
    /// Everything.
    Admin,
}

names!(Scope {
    Read = "read", Upload = "upload", Identify = "identify", Release = "release", Admin = "admin",
});

impl Scope {
    /// The scope of this name.
    pub fn parse(name: &str) -> Option<Self> {
        serde_json::from_value(name.into()).ok()
    }
}

/// Permissions of a request's key, without the key itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeyAnswer {
    /// Its identifier; `anonymous` if no key is needed.
    pub id: String,
    /// `read`, `upload`, `identify`, `release`, `admin`; the last one includes the others.
    #[schema(value_type = Vec<String>)]
    pub scopes: Vec<Scope>,
    /// The robots it is limited to; null for all.
    #[schema(required)]
    pub robots: Option<Vec<String>>,
}
