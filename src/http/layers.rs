//! What surrounds every request: an id, one log line, and problems in place of everything that layers answer on their own.

use crate::http::error::{self, Code, Error};
use crate::http::metrics::Metrics;
use crate::wire::Problem;
use crate::wire::problem::PROBLEM_JSON;
use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::any::Any;
use std::time::{Duration, Instant};
use tower_http::catch_panic::CatchPanicLayer;
use tracing::Instrument;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// What every answer says unless its handler says otherwise: nothing in it is to be run, framed, guessed at or kept.
const SAFE: [(HeaderName, HeaderValue); 5] = [
    (
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    ),
    (
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'"),
    ),
    (header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY")),
    (
        header::REFERRER_POLICY,
        HeaderValue::from_static("no-referrer"),
    ),
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
];

/// Puts all of it around a router.
pub fn surround<S: Clone + Send + Sync + 'static>(
    router: Router<S>,
    metrics: Metrics,
) -> Router<S> {
    router
        .layer(from_fn(only_problems))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(from_fn_with_state(metrics, observe))
}

/// Gives the request an id that its log lines and its answer carry, and counts it. Route templates are logged, never raw paths.
async fn observe(State(metrics): State<Metrics>, request: Request, next: Next) -> Response {
    let id = uuid::Uuid::now_v7().simple().to_string();
    let route = request
        .extensions()
        .get::<MatchedPath>()
        .map_or("-", MatchedPath::as_str)
        .to_owned();
    let method = request.method().clone();
    let span = tracing::info_span!("request", request_id = %id, %method, route);
    let begun = Instant::now();
    let mut response = next.run(request).instrument(span.clone()).await;
    let (status, duration) = (response.status(), begun.elapsed());
    let code = response
        .extensions()
        .get::<Code>()
        .map(|code| code.0.as_str());
    metrics.answered(&method, &route, status, code, duration);
    let duration_ms = duration.as_secs_f64() * 1e3;
    // Reads are many and alike; what changes something, or was refused, is worth a line. Being busy is counted only.
    span.in_scope(|| match (&method, status.as_u16()) {
        (_, 429 | 503) | (&Method::GET | &Method::HEAD, ..=399) => {
            tracing::debug!(status = status.as_u16(), duration_ms, "answered")
        }
        _ => tracing::info!(status = status.as_u16(), code, duration_ms, "answered"),
    });
    sign(&mut response, &id);
    response
}

/// The headers that every answer has.
fn sign(response: &mut Response, request_id: &str) {
    let headers = response.headers_mut();
    headers.extend(
        HeaderValue::from_str(request_id)
            .ok()
            .map(|value| (REQUEST_ID, value)),
    );
    for (name, value) in SAFE {
        headers.entry(name).or_insert(value);
    }
}

/// The answer to a request that is not looked at: before routing, authentication and body, as most requests of a flood are refused.
pub fn refuse_at_the_door(metrics: &Metrics, method: &Method) -> Response {
    let mut response = Error::Busy.into_response();
    let code = response
        .extensions()
        .get::<Code>()
        .map(|code| code.0.as_str());
    metrics.answered(method, "-", response.status(), code, Duration::ZERO);
    sign(&mut response, &uuid::Uuid::now_v7().simple().to_string());
    response
}

/// Turns error answers that a layer or extractor made on its own into problems; their headers (`Allow`, …) stay.
async fn only_problems(request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    let status = response.status();
    let is_problem = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|value| value == PROBLEM_JSON);
    if is_problem || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let mut headers = response.into_parts().0.headers;
    for name in [header::CONTENT_TYPE, header::CONTENT_LENGTH] {
        headers.remove(name);
    }
    let reason = status.canonical_reason().unwrap_or("error");
    let code = reason.to_lowercase().replace([' ', '-'], "_");
    let mut answer = error::answer(&Problem::new(status.as_u16(), &code, reason));
    answer.headers_mut().extend(headers);
    answer
}

/// A panic in a handler: the cause is logged, the client gets a 500.
fn panicked(cause: Box<dyn Any + Send + 'static>) -> Response {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| cause.downcast_ref::<&str>().copied());
    Error::Internal(format!(
        "a handler panicked: {}",
        text.unwrap_or("no message")
    ))
    .into_response()
}

/// 404 for paths that are not in the contract.
pub async fn no_such_route() -> Error {
    Error::NoSuchRoute
}

/// 405; the router adds the `Allow` header.
pub async fn method_not_allowed() -> (StatusCode, Error) {
    (StatusCode::METHOD_NOT_ALLOWED, Error::MethodNotAllowed)
}

#[cfg(test)]
mod tests {
    use super::surround;
    use crate::http::metrics::Metrics;
    use crate::wire::Problem;
    use axum::Router;
    use axum::body::{Body, to_bytes};
    use axum::http::{Request, StatusCode, header};
    use axum::routing::get;
    use tower::ServiceExt;

    async fn answer(path: &str) -> (Problem, axum::http::HeaderMap) {
        let router = Router::new()
            .route(
                "/panics",
                get(|| async {
                    if true {
                        panic!("the secret cause")
                    }
                }),
            )
            .route(
                "/plain",
                get(|| async {
                    (
                        StatusCode::IM_A_TEAPOT,
                        [(header::ALLOW, "POST")],
                        "short and stout",
                    )
                }),
            );
        let response = surround::<()>(router, Metrics::default())
            .oneshot(Request::get(path).body(Body::empty()).unwrap())
            .await
            .unwrap();
        let headers = response.headers().clone();
        let body = to_bytes(response.into_body(), 10_000).await.unwrap();
        (serde_json::from_slice(&body).unwrap(), headers)
    }

    #[tokio::test]
    async fn a_panic_is_a_problem_that_hides_its_cause() {
        let (problem, headers) = answer("/panics").await;
        assert_eq!((problem.status, problem.code.as_str()), (500, "internal"));
        assert!(!problem.detail.contains("secret"));
        assert_eq!(headers[header::CONTENT_TYPE], "application/problem+json");
        assert!(headers.contains_key("x-request-id"));
    }

    #[tokio::test]
    async fn an_error_that_a_layer_made_becomes_a_problem_and_keeps_its_headers() {
        let (problem, headers) = answer("/plain").await;
        assert_eq!(
            (problem.status, problem.code.as_str()),
            (418, "i'm_a_teapot")
        );
        assert_eq!(headers[header::ALLOW], "POST");
    }
}
