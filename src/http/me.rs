//! Permissions of the request's key, so that a page can show what its user may do.

use crate::http::Error;
use crate::http::auth::Caller;
use crate::wire::key::KeyAnswer;
use axum::Json;

/// Permissions of this request's key.
#[utoipa::path(get, path = "/v1/me", tag = "service", operation_id = "getMe", responses((status = 200, description = "The key", body = KeyAnswer)))]
pub async fn me(caller: Caller) -> Result<Json<KeyAnswer>, Error> {
    Ok(Json(KeyAnswer {
        id: caller.holder,
        name: caller.name,
        scopes: caller.scopes,
        robots: caller.robots,
    }))
}
