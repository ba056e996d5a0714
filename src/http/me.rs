//! Permissions of the request's key, so that a page can show what its user may do.

use crate::http::auth::{Caller, Scope};
use crate::http::{App, Error};
use crate::wire::key::KeyAnswer;
use axum::Json;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes of the caller.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(me))
}

/// Permissions of this request's key.
#[utoipa::path(get, path = "/v1/me", tag = "service", operation_id = "getMe", responses((status = 200, description = "The key", body = KeyAnswer)))]
async fn me(caller: Caller) -> Result<Json<KeyAnswer>, Error> {
    let scopes = caller
        .scopes
        .iter()
        .copied()
        .map(Scope::as_str)
        .map(String::from)
        .collect();
    Ok(Json(KeyAnswer {
        id: caller.holder,
        scopes,
        robots: caller.robots,
    }))
}
