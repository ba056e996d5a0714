//! What needs no key: health and the contract.

use crate::http::{App, Error, document};
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use utoipa_axum::{router::OpenApiRouter, routes};

/// Routes that need no key.
pub fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(healthz))
        .routes(routes!(readyz))
        .routes(routes!(openapi_yaml))
        .routes(routes!(openapi_json))
}

/// The process answers.
#[utoipa::path(get, path = "/healthz", tag = "service", operation_id = "healthz", responses((status = 200, description = "`ok`", body = String, content_type = "text/plain")))]
async fn healthz() -> &'static str {
    "ok\n"
}

/// The database answers. Where only part of the service is there, the text says which part is not.
#[utoipa::path(
    get, path = "/readyz", tag = "service", operation_id = "readyz",
    responses(
        (status = 200, description = "`ready`, or `ready, but …` with what is refused and why", body = String, content_type = "text/plain"),
        (status = 503, description = "Not now", body = crate::wire::Problem, content_type = "application/problem+json")
    )
)]
async fn readyz(State(app): State<App>) -> Result<String, Error> {
    app.store.now_ms().await.map_err(Error::NotReady)?;
    let without = app
        .store
        .short_of_room()
        .map(|short| format!(", but new robots, uploads and jobs are refused: {short}"));
    Ok(format!("ready{}\n", without.unwrap_or_default()))
}

/// The contract.
#[utoipa::path(get, path = "/openapi.yaml", tag = "service", operation_id = "openapiYaml", responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value, content_type = "application/yaml")))]
async fn openapi_yaml() -> Result<Response, Error> {
    let text = document::yaml().map_err(|error| Error::Internal(error.into()))?;
    Ok(([(header::CONTENT_TYPE, "application/yaml")], text).into_response())
}

/// The contract, for readers of JSON.
#[utoipa::path(get, path = "/openapi.json", tag = "service", operation_id = "openapiJson", responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value)))]
async fn openapi_json() -> Result<Response, Error> {
    let text = document::json().map_err(|error| Error::Internal(error.into()))?;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}
