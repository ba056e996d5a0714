//! What needs no key: the front page, health, and the contract.

use crate::http::{App, Error, document};
use axum::extract::State;
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use utoipa_axum::{router::OpenApiRouter, routes};

/// Self-contained: factories are offline.
const PAGE: &str = include_str!("index.html");
/// Nothing but this page's own style.
const CONTENT_SECURITY_POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Routes that need no key.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(index)).routes(routes!(healthz)).routes(routes!(readyz)).routes(routes!(openapi_yaml))
}

/// What this is.
#[utoipa::path(get, path = "/", tag = "service", operation_id = "index", responses((status = 200, description = "A page", body = String, content_type = "text/html")))]
async fn index() -> Response {
    ([(header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY)], Html(PAGE)).into_response()
}

/// The process answers.
#[utoipa::path(get, path = "/healthz", tag = "service", operation_id = "healthz", responses((status = 200, description = "`ok`", body = String, content_type = "text/plain")))]
async fn healthz() -> &'static str {
    "ok\n"
}

/// The database answers.
#[utoipa::path(
    get, path = "/readyz", tag = "service", operation_id = "readyz",
    responses(
        (status = 200, description = "`ready`", body = String, content_type = "text/plain"),
        (status = 503, description = "Not now", body = crate::wire::Problem, content_type = "application/problem+json")
    )
)]
async fn readyz(State(app): State<App>) -> Result<&'static str, Error> {
    app.store.now_ms().await.map_err(|error| Error::NotReady(format!("{error:?}")))?;
    Ok("ready\n")
}

/// The contract.
#[utoipa::path(get, path = "/openapi.yaml", tag = "service", operation_id = "openapiYaml", responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value, content_type = "application/yaml")))]
async fn openapi_yaml() -> Result<Response, Error> {
    let text = document::yaml().map_err(|error| Error::Internal(error.into()))?;
    Ok(([(header::CONTENT_TYPE, "application/yaml")], text).into_response())
}
