//! Authentication and authorisation: keys, scopes, and the table of the scope that each route requires.

use crate::http::peer::Peer;
use crate::http::session_cookie;
use crate::http::{App, Error};
use crate::store::{ApiKeyRow, api_keys};
use crate::wire::canonical;
use crate::wire::key::Scope;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Prefix of every key, so that secret scanners recognise a leaked one.
const KEY_PREFIX: &str = "kincal_";
/// Random bytes of a key: 256 bits.
const KEY_BYTES: usize = 32;

const UNKNOWN_KEY: &str =
    "this key is not known or was revoked; `kincal key create` makes a new one";

/// A route that requires a key.
#[derive(Debug)]
pub struct ScopedRoute {
    /// Its method.
    pub method: Method,
    /// Its path, as a template.
    pub path: &'static str,
    /// The scope that the key needs.
    pub scope: Scope,
}

const fn route(method: Method, path: &'static str, scope: Scope) -> ScopedRoute {
    ScopedRoute {
        method,
        path,
        scope,
    }
}

/// Every route that requires a key, with its scope. A route that is neither here nor in [`PUBLIC_ROUTES`] is refused. A test compares both lists
/// with the contract.
pub const REQUIRED_SCOPES: &[ScopedRoute] = &[
    route(Method::GET, "/v1/me", Scope::Read),
    route(Method::PUT, "/v1/session", Scope::Read),
    route(Method::DELETE, "/v1/session", Scope::Read),
    route(Method::GET, "/metrics", Scope::Read),
    route(Method::POST, "/v1/robots", Scope::Upload),
    route(Method::GET, "/v1/robots", Scope::Read),
    route(Method::GET, "/v1/overview", Scope::Read),
    route(Method::GET, "/v1/robots/{robot_id}", Scope::Read),
    route(Method::PATCH, "/v1/robots/{robot_id}", Scope::Upload),
    route(Method::POST, "/v1/robots/{robot_id}/archive", Scope::Upload),
    route(Method::POST, "/v1/robots/{robot_id}/restore", Scope::Upload),
    route(
        Method::POST,
        "/v1/robots/{robot_id}/measurement-sets",
        Scope::Upload,
    ),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/measurement-sets",
        Scope::Read,
    ),
    route(
        Method::POST,
        "/v1/robots/{robot_id}/measurement-sets/preview",
        Scope::Upload,
    ),
    route(Method::GET, "/v1/robots/{robot_id}/columns", Scope::Read),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/columns/{name}",
        Scope::Read,
    ),
    route(
        Method::PUT,
        "/v1/robots/{robot_id}/columns/{name}",
        Scope::Upload,
    ),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/work-frames",
        Scope::Read,
    ),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/work-frames/{name}",
        Scope::Read,
    ),
    route(
        Method::PUT,
        "/v1/robots/{robot_id}/work-frames/{name}",
        Scope::Upload,
    ),
    route(Method::GET, "/v1/robots/{robot_id}/tools", Scope::Read),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/tools/{name}",
        Scope::Read,
    ),
    route(
        Method::PUT,
        "/v1/robots/{robot_id}/tools/{name}",
        Scope::Upload,
    ),
    route(Method::GET, "/v1/measurement-sets/{id}", Scope::Read),
    route(Method::GET, "/v1/measurement-sets/{id}/points", Scope::Read),
    route(
        Method::POST,
        "/v1/measurement-sets/{id}/archive",
        Scope::Upload,
    ),
    route(
        Method::POST,
        "/v1/measurement-sets/{id}/restore",
        Scope::Upload,
    ),
    route(Method::POST, "/v1/robots/{robot_id}/frames", Scope::Upload),
    route(Method::GET, "/v1/frames/{id}", Scope::Read),
    route(Method::POST, "/v1/robots/{robot_id}/jobs", Scope::Identify),
    route(Method::GET, "/v1/robots/{robot_id}/jobs", Scope::Read),
    route(Method::GET, "/v1/jobs", Scope::Read),
    route(Method::GET, "/v1/jobs/{id}", Scope::Read),
    route(Method::POST, "/v1/jobs/{id}/archive", Scope::Identify),
    route(Method::POST, "/v1/jobs/{id}/restore", Scope::Identify),
    route(Method::GET, "/v1/jobs/{id}/events", Scope::Read),
    route(Method::POST, "/v1/jobs/{id}/cancel", Scope::Identify),
    route(Method::GET, "/v1/jobs/{id}/report", Scope::Read),
    route(Method::GET, "/v1/jobs/{id}/report.html", Scope::Read),
    route(Method::GET, "/v1/jobs/{id}/convergence", Scope::Read),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/parameter-sets",
        Scope::Read,
    ),
    route(
        Method::GET,
        "/v1/robots/{robot_id}/parameter-sets/active",
        Scope::Read,
    ),
    route(Method::GET, "/v1/parameter-sets/{id}", Scope::Read),
    route(Method::GET, "/v1/parameter-sets/{id}/gates", Scope::Read),
    route(Method::GET, "/v1/parameter-sets/{id}/content", Scope::Read),
    route(
        Method::POST,
        "/v1/robots/{robot_id}/checked",
        Scope::Release,
    ),
    route(Method::GET, "/v1/robots/{robot_id}/policy", Scope::Read),
    route(Method::PUT, "/v1/robots/{robot_id}/policy", Scope::Admin),
    route(
        Method::POST,
        "/v1/robots/{robot_id}/parameter-sets/rollback",
        Scope::Release,
    ),
    route(
        Method::POST,
        "/v1/parameter-sets/{id}/release",
        Scope::Release,
    ),
    route(
        Method::POST,
        "/v1/parameter-sets/{id}/withdraw",
        Scope::Release,
    ),
    route(
        Method::POST,
        "/v1/parameter-sets/{id}/archive",
        Scope::Release,
    ),
    route(
        Method::POST,
        "/v1/parameter-sets/{id}/restore",
        Scope::Release,
    ),
    route(Method::POST, "/v1/parameter-sets/{id}/predict", Scope::Read),
    route(
        Method::POST,
        "/v1/parameter-sets/{id}/compensate",
        Scope::Read,
    ),
    route(Method::GET, "/v1/parameter-sets/{id}/export", Scope::Read),
    route(Method::POST, "/v1/parameter-sets/{id}/export", Scope::Read),
    route(Method::GET, "/v1/parameter-sets/{id}/compare", Scope::Read),
    route(Method::POST, "/v1/robot-imports", Scope::Upload),
    route(Method::GET, "/v1/robot-models", Scope::Read),
    route(Method::GET, "/v1/robot-models/{id}", Scope::Read),
    route(Method::POST, "/v1/robots/{robot_id}/posture", Scope::Read),
    route(Method::GET, "/v1/robots/{robot_id}/history", Scope::Read),
    route(
        Method::POST,
        "/v1/robots/{robot_id}/pose-plans",
        Scope::Read,
    ),
    route(Method::GET, "/v1/robots/{robot_id}/networks", Scope::Read),
    route(Method::GET, "/v1/networks/{id}", Scope::Read),
    route(Method::GET, "/v1/networks/{id}/weights", Scope::Read),
    route(Method::POST, "/v1/networks/{id}/archive", Scope::Identify),
    route(Method::POST, "/v1/networks/{id}/restore", Scope::Identify),
];

/// Routes that need no key.
pub const PUBLIC_ROUTES: &[&str] = &[
    "/",
    "/docs",
    "/assets/{file}",
    "/healthz",
    "/readyz",
    "/openapi.yaml",
    "/openapi.json",
];

/// The authenticated client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// The key's id; `anonymous` with `--no-auth`. Idempotency-Keys are scoped to it.
    pub holder: String,
    /// What the key may do.
    pub scopes: Vec<Scope>,
    /// The robots that the key is limited to; `None` for all robots.
    pub robots: Option<Vec<String>>,
}

impl Caller {
    fn anonymous() -> Self {
        Self {
            holder: "anonymous".into(),
            scopes: vec![Scope::Admin],
            robots: None,
        }
    }

    /// Whether the key has this scope.
    pub fn has(&self, scope: Scope) -> bool {
        self.scopes.contains(&scope) || self.scopes.contains(&Scope::Admin)
    }

    /// Whether the key may see this robot. If it may not, every id of the robot answers 404.
    pub fn may_see(&self, robot_id: &str) -> bool {
        self.robots
            .as_ref()
            .is_none_or(|robots| robots.iter().any(|id| id == robot_id))
    }
}

impl TryFrom<ApiKeyRow> for Caller {
    type Error = Error;

    fn try_from(row: ApiKeyRow) -> Result<Self, Error> {
        Ok(Self {
            scopes: known_scopes(&row)?,
            robots: row
                .robots_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            holder: row.id,
        })
    }
}

/// The scopes of a key. An unknown scope, from a key that a newer version made, is ignored.
fn known_scopes(row: &ApiKeyRow) -> Result<Vec<Scope>, Error> {
    let names: Vec<String> = serde_json::from_str(&row.scopes_json)?;
    let mut scopes = Vec::with_capacity(names.len());
    for name in names {
        match Scope::parse(&name) {
            Some(scope) => scopes.push(scope),
            None => tracing::warn!(
                key_id = row.id,
                scope = name,
                "a key has a scope that this version does not know; it is ignored"
            ),
        }
    }
    Ok(scopes)
}

/// Lets a request through if its key has the route's scope.
pub async fn authorize(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let template = request
        .extensions()
        .get::<MatchedPath>()
        .map(|path| path.as_str().to_owned());
    let (method, headers) = (request.method().clone(), request.headers().clone());
    let peer = request.extensions().get::<Peer>().copied();
    match admit(&app, template.as_deref(), &method, &headers, peer).await {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(Refusal::Error(error)) => {
            let forget =
                matches!(error, Error::Unauthorized(_)) && session_cookie::is_present(&headers);
            let mut response = error.into_response();
            if forget {
                let cookie = session_cookie::signing_out(app.has_tls);
                let header = cookie.map(|value| (header::SET_COOKIE, value));
                response.headers_mut().extend(header);
            }
            response
        }
        Err(Refusal::Method(allow)) => {
            let mut response = Error::MethodNotAllowed.into_response();
            response.headers_mut().extend(
                HeaderValue::from_str(&allow)
                    .ok()
                    .map(|value| (header::ALLOW, value)),
            );
            response
        }
    }
}

enum Refusal {
    Error(Error),
    Method(String),
}

async fn admit(
    app: &App,
    template: Option<&str>,
    method: &Method,
    headers: &HeaderMap,
    peer: Option<Peer>,
) -> Result<Caller, Refusal> {
    let Some(template) = template.filter(|template| !PUBLIC_ROUTES.contains(template)) else {
        return Ok(Caller::anonymous());
    };
    let caller = if app.no_auth {
        Caller::anonymous()
    } else {
        caller_of(app, method, headers, peer)
            .await
            .map_err(Refusal::Error)?
    };
    app.limits
        .count_request(&caller.holder)
        .map_err(Refusal::Error)?;
    let method = if method == Method::HEAD {
        &Method::GET
    } else {
        method
    };
    match REQUIRED_SCOPES
        .iter()
        .find(|route| route.method == method && route.path == template)
    {
        Some(route) if caller.has(route.scope) => Ok(caller),
        Some(route) => Err(Refusal::Error(Error::InsufficientScope {
            scope: route.scope.as_str(),
            what: "this route",
        })),
        None => Err(allowed_methods(template).map_or(
            Refusal::Error(Error::Forbidden("this route has no policy")),
            Refusal::Method,
        )),
    }
}

fn allowed_methods(template: &str) -> Option<String> {
    let methods = REQUIRED_SCOPES
        .iter()
        .filter(|route| route.path == template);
    let methods: Vec<&str> = methods
        .flat_map(|route| {
            if route.method == Method::GET {
                vec!["GET", "HEAD"]
            } else {
                vec![route.method.as_str()]
            }
        })
        .collect();
    (!methods.is_empty()).then(|| methods.join(","))
}

/// The key in the `Authorization` header; `None` without that header.
///
/// # Errors
/// [`Error::Unauthorized`] if it is not of the form `Bearer KEY`.
pub fn bearer(headers: &HeaderMap) -> Result<Option<&str>, Error> {
    let Some(value) = headers.get(header::AUTHORIZATION) else {
        return Ok(None);
    };
    let key = value.to_str().ok().and_then(|text| text.split_once(' '));
    key.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
        .map(|(_, key)| Some(key.trim()))
        .ok_or(Error::Unauthorized(
            "the Authorization header should read `Bearer KEY`",
        ))
}

async fn caller_of(
    app: &App,
    method: &Method,
    headers: &HeaderMap,
    peer: Option<Peer>,
) -> Result<Caller, Error> {
    let key = match bearer(headers)? {
        Some(key) => Some(key),
        None => session_cookie::key_of(method, headers)?,
    };
    let key = key.ok_or(Error::Unauthorized(
        "a key is needed: send `Authorization: Bearer KEY`; `kincal key create` makes one",
    ))?;
    match api_keys::find(&app.store, &canonical::sha256_hex(key.as_bytes())).await? {
        Some(row) => Caller::try_from(row),
        None => Err(app
            .limits
            .count_failed_attempt(peer.map(|peer| peer.0))
            .err()
            .unwrap_or(Error::Unauthorized(UNKNOWN_KEY))),
    }
}

/// Whether the key of a long request is still valid; false if the database cannot be read.
pub async fn is_still_valid(app: &App, caller: &Caller) -> bool {
    app.no_auth
        || api_keys::get(&app.store, &caller.holder)
            .await
            .is_ok_and(|row| row.revoked_at_ms.is_none())
}

/// A key that was just made.
pub struct NewKey {
    /// Its text, which is shown once.
    pub text: String,
    /// Its hash, which is stored.
    pub sha256: String,
}

/// Makes a key.
///
/// # Errors
/// If the operating system has no random numbers.
pub fn new_key() -> Result<NewKey, Error> {
    let mut random = [0_u8; KEY_BYTES];
    getrandom::fill(&mut random)
        .map_err(|error| Error::Internal(format!("no random numbers: {error}")))?;
    let text = format!("{KEY_PREFIX}{}", canonical::hex(&random));
    let sha256 = canonical::sha256_hex(text.as_bytes());
    Ok(NewKey { text, sha256 })
}
