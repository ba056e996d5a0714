//! Middleware of every request: an id, a log line, and problem documents for errors of other layers.

use crate::http::counters::Metrics;
use crate::http::error::{self, Code, Error};
use crate::http::jobs::WaitQuery;
use crate::wire::Problem;
use crate::wire::problem::PROBLEM_JSON;
use axum::Router;
use axum::extract::{MatchedPath, Query, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::any::Any;
use std::time::{Duration, Instant};
use tower_http::catch_panic::CatchPanicLayer;
use tracing::Instrument;

/// Header with the id of the request, in every answer.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Default security headers; a handler may set its own.
const SECURITY_HEADERS: [(HeaderName, HeaderValue); 5] = [
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

/// Adds the middleware to a router.
pub fn with_middleware<S: Clone + Send + Sync + 'static>(
    router: Router<S>,
    metrics: Metrics,
) -> Router<S> {
    router
        .layer(from_fn(convert_to_problem))
        .layer(CatchPanicLayer::custom(panic_response))
        .layer(from_fn_with_state(metrics, observe))
}

/// Gives the request an id, which is in its log lines and in its answer, and counts the request. Logs route templates, never raw paths.
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
    metrics.record_answer(&method, &route, status, code, duration);
    let duration_ms = duration.as_secs_f64() * 1e3;
    // Successful reads and overload are logged at debug only; both are counted.
    span.in_scope(|| match (&method, status.as_u16()) {
        (_, 429 | 503) | (&Method::GET | &Method::HEAD, ..=399) => {
            tracing::debug!(status = status.as_u16(), duration_ms, "answered")
        }
        _ => tracing::info!(status = status.as_u16(), code, duration_ms, "answered"),
    });
    add_common_headers(response.headers_mut(), &id);
    response
}

/// The headers that every answer has.
fn add_common_headers(headers: &mut HeaderMap, request_id: &str) {
    headers.extend(
        HeaderValue::from_str(request_id)
            .ok()
            .map(|value| (REQUEST_ID, value)),
    );
    for (name, value) in SECURITY_HEADERS {
        headers.entry(name).or_insert(value);
    }
}

/// Whether a request takes no permit before routing. Health and metrics must answer under load, and a long poll takes a permit of its own.
pub fn is_unlimited(uri: &Uri) -> bool {
    matches!(uri.path(), "/healthz" | "/readyz" | "/metrics") || may_wait(uri)
}

/// Whether a request is a long poll: a GET of a job with `wait_s`. It takes a permit to wait instead of one to read.
fn may_wait(uri: &Uri) -> bool {
    let job = uri.path().strip_prefix("/v1/jobs/");
    job.is_some_and(|id| !id.contains('/'))
        && Query::try_from_uri(uri).is_ok_and(|Query(query): Query<WaitQuery>| query.waits())
}

/// Answers a refused request without routing it, authenticating it or reading its body. Under overload most requests end here.
pub fn refuse_unrouted(metrics: &Metrics, method: &Method, error: Error) -> Response {
    let mut response = error.into_response();
    let code = response
        .extensions()
        .get::<Code>()
        .map(|code| code.0.as_str());
    metrics.record_answer(method, "-", response.status(), code, Duration::ZERO);
    add_common_headers(
        response.headers_mut(),
        &uuid::Uuid::now_v7().simple().to_string(),
    );
    response
}

/// The problem for a request that hyper refuses before routing. hyper writes its status.
pub fn unrouted_problem(error: &Error) -> Response<Vec<u8>> {
    let body = serde_json::to_vec(&error.problem()).unwrap_or_default();
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
    add_common_headers(headers, &uuid::Uuid::now_v7().simple().to_string());
    response
}

/// Converts error answers of other layers and extractors to problems. Their headers (`Allow`, …) stay.
async fn convert_to_problem(request: Request, next: Next) -> Response {
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

/// Answers a panic in a handler with 500 and logs the cause.
fn panic_response(cause: Box<dyn Any + Send + 'static>) -> Response {
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
    use super::{is_unlimited, with_middleware};
    use crate::http::counters::Metrics;
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
        let response = with_middleware::<()>(router, Metrics::default())
            .oneshot(Request::get(path).body(Body::empty()).unwrap())
            .await
            .unwrap();
        let headers = response.headers().clone();
        let body = to_bytes(response.into_body(), 10_000).await.unwrap();
        (serde_json::from_slice(&body).unwrap(), headers)
    }

    #[test]
    fn only_a_get_that_waits_takes_no_permit_to_read() {
        for (path, expected) in [
            ("/metrics", true),
            ("/v1/jobs/job_0?wait_s=1", true),
            ("/v1/jobs/job_0?%77ait_s=1", true),
            ("/v1/jobs/job_0?wait_s=0", false),
            ("/v1/jobs/job_0?x=1", false),
            ("/v1/jobs/job_0?", false),
            ("/v1/jobs/job_0/report?wait_s=1", false),
        ] {
            assert_eq!(is_unlimited(&path.parse().unwrap()), expected, "{path}");
        }
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
