//! What a key may do.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Permissions of a request's key, without the key itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeyAnswer {
    /// Its identifier; `anonymous` if no key is needed.
    pub id: String,
    /// `read`, `upload`, `identify`, `release`, `admin`; the last one includes the others.
    pub scopes: Vec<String>,
    /// The robots it is limited to; null for all.
    #[schema(required)]
    pub robots: Option<Vec<String>>,
}
