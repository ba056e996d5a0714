//! The only place where an error becomes a status.

use crate::calibration;
use crate::store;
use crate::wire::problem::PROBLEM_JSON;
use crate::wire::{Invalid, Issue, Problem, json};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Code of an error answer, for the counters.
#[derive(Clone, Debug)]
pub struct Code(pub String);

/// `Retry-After` of 429, 503 and 507, seconds.
const RETRY_AFTER_S: &str = "1";

/// Errors of the service.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The row does not exist, or this key may not see it.
    #[error("there is no {0} with this id")]
    NotFound(&'static str),
    /// The robot has no released parameter set.
    #[error("the robot has no released parameter set: release one first")]
    NoActiveParameterSet,
    /// The contract has no such path.
    #[error("this path does not exist; /openapi.yaml lists all paths")]
    NoSuchRoute,
    /// The path exists, but takes other methods.
    #[error("this path does not take this method; see the Allow header")]
    MethodNotAllowed,
    /// The body is not JSON.
    #[error("the body is not JSON: {0}")]
    Syntax(String),
    /// Path, query or a header cannot be read.
    #[error("{detail}")]
    BadRequest {
        /// Machine-readable code; it never changes.
        code: &'static str,
        /// What is wrong, where, and how to correct it.
        detail: String,
    },
    /// The request was parsed, but values in it are invalid.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The core cannot use the request.
    #[error("{detail}")]
    Unusable {
        /// Machine-readable code from the core; it never changes.
        code: &'static str,
        /// Description.
        detail: String,
    },
    /// No key, or an unknown one.
    #[error("{0}")]
    Unauthorized(&'static str),
    /// The key lacks the scope that the route requires.
    #[error(
        "this key lacks the scope {scope:?}, which {what} requires; make a key with it by `kincal key create --scope {scope} …`"
    )]
    InsufficientScope {
        /// Name of the scope.
        scope: &'static str,
        /// What requires it.
        what: &'static str,
    },
    /// The key may not do this with any scope.
    #[error("{0}")]
    Forbidden(&'static str),
    /// A server without keys was called by a name that is not a loopback name.
    #[error(
        "this server takes no keys (--no-auth), so it answers to localhost, 127.0.0.1 and [::1] only, not to {0:?}: use http://localhost:PORT, or serve without --no-auth and give clients keys"
    )]
    HostNotLoopback(String),
    /// A page of another site sent a request to a server without keys.
    #[error(
        "{0}. This server takes no keys (--no-auth), so it does nothing for other sites' pages: use its own page, or serve without --no-auth and give clients keys"
    )]
    ForeignOrigin(String),
    /// hyper could not read the request, and gives no details.
    #[error(
        "the request is not valid HTTP/1.1: check its first line, its header, Content-Length and Transfer-Encoding"
    )]
    MalformedRequest,
    /// The header is too large.
    #[error(
        "the request's header is too large: send less than 32 KiB and at most 100 fields (cookies of other services on this host count, too)"
    )]
    HeaderTooLarge,
    /// The URI is too long.
    #[error("the request's URI is too long: send less than 32 KiB")]
    UriTooLong,
    /// The body did not arrive in time.
    #[error("the request did not arrive in time")]
    RequestTimeout,
    /// The body is too large.
    #[error("the body is larger than the limit of {limit} bytes: {advice}")]
    TooLarge {
        /// The limit.
        limit: usize,
        /// What the client can do instead.
        advice: &'static str,
    },
    /// The route does not accept the body's media type.
    #[error("the body is {found}; this route takes {expected}")]
    UnsupportedMediaType {
        /// The media type that was sent.
        found: String,
        /// The media types that are accepted.
        expected: &'static str,
    },
    /// The Idempotency-Key was used for another request.
    #[error(
        "this Idempotency-Key was used for another request on this path; use a new key for a new request"
    )]
    IdempotencyKeyReused,
    /// The request conflicts with the current state.
    #[error("{detail}")]
    Conflict {
        /// Machine-readable code; it never changes.
        code: &'static str,
        /// Description.
        detail: String,
        /// The separate reasons, e.g. the gates that failed.
        errors: Vec<Issue>,
    },
    /// An error of the store.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// A concurrency limit is reached.
    #[error("the server is busy: try again")]
    Busy,
    /// A rate limit is reached.
    #[error("{0}: wait a little")]
    RateLimited(&'static str),
    /// The database does not answer.
    #[error("the database does not answer: {}", .0.reason())]
    NotReady(store::Error),
    /// The database answers but does not accept writes.
    #[error("{0}")]
    WritersStuck(store::stuck::StuckWriters),
    /// A defect or an unexpected failure; the cause goes to the log only.
    #[error("{0}")]
    Internal(String),
}

impl From<json::Error> for Error {
    fn from(error: json::Error) -> Self {
        match error {
            json::Error::Syntax(detail) => Self::Syntax(detail),
            json::Error::Shape(invalid) => Self::Invalid(invalid),
        }
    }
}

impl From<calibration::Error> for Error {
    fn from(error: calibration::Error) -> Self {
        match error {
            calibration::Error::Unusable { code, detail } => Self::Unusable { code, detail },
            calibration::Error::Cancelled => Self::Internal("a check was cancelled".into()),
        }
    }
}

impl From<serde_json::Error> for Error {
    fn from(error: serde_json::Error) -> Self {
        Self::Internal(format!(
            "a stored document cannot be read or written: {error}"
        ))
    }
}

fn from_store(error: &store::Error) -> Problem {
    use store::Error as E;
    let (status, code, detail) = match error {
        E::NotFound => (404, "not_found", "there is nothing with this id".into()),
        E::Conflict(conflict) => return from_conflict(conflict),
        E::LowDiskSpace { .. } => (
            507,
            "no_room",
            format!("{error}: free space on the disk, or move the data directory"),
        ),
        E::Open { .. } | E::Database(_) if error.is_unavailable() => (
            503,
            "unavailable",
            format!(
                "the database cannot be written or read right now, {}: try again",
                error.reason()
            ),
        ),
        E::Open { .. } | E::Database(_) => return internal(),
    };
    Problem::new(status, code, detail)
}

fn from_conflict(conflict: &store::Conflict) -> Problem {
    use store::{Conflict as C, JobStatus};
    let (status, code, advice) = match conflict {
        C::JobStatus {
            status: JobStatus::Queued | JobStatus::Running,
        } => {
            let detail =
                "the job is not over yet: poll it with ?wait_s=30, or listen to its events";
            return Problem::new(409, "not_finished", detail);
        }
        C::JobStatus { status } => {
            let why = match status {
                JobStatus::Failed => "; its `error` says why",
                _ => "",
            };
            let detail = format!("the job is {}, so it has no result{why}", status.as_str());
            return Problem::new(409, "no_result", detail);
        }
        C::QueueFull { .. } => (
            429,
            "queue_full",
            ": wait until some are done, or cancel some",
        ),
        C::Withdrawn => (
            409,
            "release_refused",
            ": identify anew, or release another set",
        ),
        C::ActiveChanged => (409, "release_refused", ": check that set, then try again"),
        C::ChecksOutdated => (
            409,
            "release_refused",
            ": check the gates again, then try again",
        ),
        C::RefusedBySchema { .. } => (409, "release_refused", ": see its gates"),
        C::RobotArchived => (409, "archived", ": restore it first"),
        C::Archived { .. } => (
            409,
            "archived",
            ": restore it, or send the request again; if the request names it, leave it out",
        ),
        C::NotArchivable { .. } => (409, "not_archivable", ""),
        C::RobotChanged => (409, "robot_changed", ": read it again, then try again"),
        C::JointMapReleased => (
            409,
            "joint_map_released",
            ", and cells rely on it: store a new robot with the other joint map, and archive this one",
        ),
        C::NothingToRollBackTo => (409, "nothing_to_roll_back_to", ""),
        C::LeaseLost | C::Duplicate => (409, "conflict", ""),
    };
    Problem::new(status, code, format!("{conflict}{advice}"))
}

fn internal() -> Problem {
    let detail = "something went wrong inside kincal; the log has the cause under this answer's X-Request-Id";
    Problem::new(500, "internal", detail)
}

impl Error {
    /// A path, query or header that cannot be read.
    pub fn bad_request(code: &'static str, detail: impl Into<String>) -> Self {
        let detail = detail.into();
        Self::BadRequest { code, detail }
    }

    /// A query with a value that is not allowed.
    pub fn invalid_query(detail: impl Into<String>) -> Self {
        Self::bad_request("invalid_query", detail)
    }

    /// A conflict with the current state.
    pub fn conflict(code: &'static str, detail: impl Into<String>) -> Self {
        Self::Conflict {
            code,
            detail: detail.into(),
            errors: vec![],
        }
    }

    fn without_errors(&self) -> Problem {
        let (status, code) = match self {
            Self::NotFound(_) => (404, "not_found"),
            Self::NoActiveParameterSet => (404, "no_active_parameter_set"),
            Self::NoSuchRoute => (404, "no_such_route"),
            Self::MethodNotAllowed => (405, "method_not_allowed"),
            Self::Syntax(_) => (400, "malformed_json"),
            Self::BadRequest { code, .. } => (400, *code),
            Self::Invalid(invalid) => (422, invalid.code),
            Self::Unusable {
                code: code @ ("no_network" | "network_mismatch"),
                ..
            } => (409, *code),
            Self::Unusable { code, .. } => (422, *code),
            Self::Unauthorized(_) => (401, "unauthorized"),
            Self::InsufficientScope { .. } => (403, "insufficient_scope"),
            Self::Forbidden(_) => (403, "forbidden"),
            Self::HostNotLoopback(_) => (421, "host_not_loopback"),
            Self::ForeignOrigin(_) => (403, "foreign_origin"),
            Self::MalformedRequest => (400, "malformed_request"),
            Self::HeaderTooLarge => (431, "header_too_large"),
            Self::UriTooLong => (414, "uri_too_long"),
            Self::RequestTimeout => (408, "request_timeout"),
            Self::TooLarge { .. } => (413, "too_large"),
            Self::UnsupportedMediaType { .. } => (415, "unsupported_media_type"),
            Self::IdempotencyKeyReused => (422, "idempotency_key_reused"),
            Self::Conflict { code, .. } => (409, *code),
            Self::Busy => (503, "overloaded"),
            Self::RateLimited(_) => (429, "rate_limited"),
            Self::NotReady(_) | Self::WritersStuck(_) => (503, "not_ready"),
            Self::Store(error) => return from_store(error),
            Self::Internal(_) => return internal(),
        };
        Problem::new(status, code, self.to_string())
    }

    /// The problem that the client gets.
    pub fn problem(&self) -> Problem {
        let errors = match self {
            Self::Invalid(invalid) => invalid.issues.clone(),
            Self::Conflict { errors, .. } => errors.clone(),
            _ => Vec::new(),
        };
        Problem {
            errors,
            ..self.without_errors()
        }
    }

    fn headers(&self, status: u16) -> Vec<(HeaderName, HeaderValue)> {
        let challenge = |text: String| {
            HeaderValue::from_str(&text)
                .map(|value| (header::WWW_AUTHENTICATE, value))
                .into_iter()
                .collect()
        };
        match self {
            Self::Unauthorized(_) => challenge("Bearer realm=\"kincal\"".into()),
            Self::InsufficientScope { scope, .. } => challenge(format!(
                "Bearer realm=\"kincal\", error=\"insufficient_scope\", scope=\"{scope}\""
            )),
            _ if matches!(status, 429 | 503 | 507) => {
                vec![(header::RETRY_AFTER, HeaderValue::from_static(RETRY_AFTER_S))]
            }
            _ => Vec::new(),
        }
    }
}

/// The answer for a problem.
pub fn answer(problem: &Problem) -> Response {
    let body = serde_json::to_vec(problem).unwrap_or_default();
    let status = StatusCode::from_u16(problem.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let mut response = (status, [(header::CONTENT_TYPE, PROBLEM_JSON)], body).into_response();
    response.extensions_mut().insert(Code(problem.code.clone()));
    response
}

impl IntoResponse for Error {
    fn into_response(self) -> Response {
        let problem = self.problem();
        // Overload is counted, not logged: logging would make it worse.
        if problem.status >= 500 && !matches!(self, Self::Busy) {
            tracing::error!(status = problem.status, cause = ?self, "request failed");
        }
        let mut response = answer(&problem);
        response.headers_mut().extend(self.headers(problem.status));
        response
    }
}
