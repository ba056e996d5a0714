//! Routes without a key: health and the contract.

use crate::http::{App, Error};
use crate::store::stuck::stuck_writers;
use axum::Extension;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use std::time::Duration;

/// Functions that return the contract. The contract is generated from all routes, including those below, so the router passes the functions in.
#[derive(Clone, Copy, Debug)]
pub struct Contract {
    /// In YAML.
    pub yaml: fn() -> Result<&'static str, &'static str>,
    /// In JSON.
    pub json: fn() -> Result<&'static str, &'static str>,
}

/// Liveness: the process answers.
#[utoipa::path(get, path = "/healthz", tag = "service", operation_id = "healthz", responses((status = 200, description = "`ok`", body = String, content_type = "text/plain")))]
pub async fn healthz() -> &'static str {
    "ok\n"
}

/// Shortest reported time without a successful write.
const STUCK: Duration = Duration::from_secs(1);
/// Time without a successful write after which the node is not ready. Until then it is ready, because it answers reads.
const STUCK_TOO_LONG: Duration = Duration::from_secs(60);

/// Readiness: the database answers. If part of the service is not available, the text says which part, and for how long writers have been stuck.
#[utoipa::path(
    get, path = "/readyz", tag = "service", operation_id = "readyz",
    responses(
        (status = 200, description = "`ready`, or `ready, but …` with what is refused and why; `ready, but no write has succeeded for 4.2 s: …` while writers are stuck, for less than 60 s", body = String, content_type = "text/plain"),
        (status = 503, description = "Not now: the database does not answer, or no write has succeeded for 60 s or more", body = crate::wire::Problem, content_type = "application/problem+json")
    )
)]
pub async fn readyz(State(app): State<App>) -> Result<String, Error> {
    app.store.now_ms().await.map_err(Error::NotReady)?;
    let stuck = stuck_writers(&app.store).await.map_err(Error::NotReady)?;
    if let Some(stuck) = stuck.filter(|stuck| stuck.duration >= STUCK_TOO_LONG) {
        return Err(Error::WritersStuck(stuck));
    }
    let limitations = [
        app.store
            .low_disk_space()
            .map(|short| format!(", but new robots, uploads and jobs are refused: {short}")),
        stuck
            .filter(|stuck| stuck.duration >= STUCK)
            .map(|stuck| format!(", but {stuck}")),
    ];
    Ok(format!(
        "ready{}\n",
        limitations.into_iter().flatten().collect::<String>()
    ))
}

/// The contract.
#[utoipa::path(get, path = "/openapi.yaml", tag = "service", operation_id = "openapiYaml", responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value, content_type = "application/yaml")))]
pub async fn openapi_yaml(Extension(contract): Extension<Contract>) -> Result<Response, Error> {
    let text = (contract.yaml)().map_err(|error| Error::Internal(error.into()))?;
    Ok(([(header::CONTENT_TYPE, "application/yaml")], text).into_response())
}

/// The contract in JSON.
#[utoipa::path(get, path = "/openapi.json", tag = "service", operation_id = "openapiJson", responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value)))]
pub async fn openapi_json(Extension(contract): Extension<Contract>) -> Result<Response, Error> {
    let text = (contract.json)().map_err(|error| Error::Internal(error.into()))?;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}
