//! Authentication and authorisation: keys and their scopes.

use crate::http::limits::RequestClass;
use crate::http::route::Route;
use crate::http::session_cookie;
use crate::http::{App, Error};
use crate::store::{ApiKeyRow, api_keys, browser_sessions};
use crate::wire::canonical;
use crate::wire::key::Scope;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{Extensions, HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;

/// Prefix of every key, so that secret scanners recognise a leaked one.
const KEY_PREFIX: &str = "kincal_";
/// Random bytes of a key or of a session's token: 256 bits.
const RANDOM_BYTES: usize = 32;

const UNKNOWN_KEY: &str =
    "this key is not known or was revoked; `kincal key create` makes a new one";
const SESSION_ENDED: &str = "the session of this browser has ended: sign in again";

/// Address of the client; the accept loop adds it to each request.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub IpAddr);

/// The authenticated client, and the class of its request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// The key's id; `anonymous` with `--no-auth`. Idempotency-Keys are scoped to it.
    pub holder: String,
    /// The key's name; `None` with `--no-auth`.
    pub name: Option<String>,
    /// What the key may do.
    pub scopes: Vec<Scope>,
    /// The robots that the key is limited to; `None` for all robots.
    pub robots: Option<Vec<String>>,
    /// Hash of the token of the browser's session; `None` if the request sent a key.
    pub session_sha256: Option<String>,
    /// The class of this request, which decides the permits that it takes.
    pub class: RequestClass,
}

impl Caller {
    fn new(
        row: ApiKeyRow,
        session_sha256: Option<String>,
        class: RequestClass,
    ) -> Result<Self, Error> {
        Ok(Self {
            scopes: known_scopes(&row)?,
            robots: row
                .robots_json
                .as_deref()
                .map(serde_json::from_str)
                .transpose()?,
            holder: row.id,
            name: Some(row.name),
            session_sha256,
            class,
        })
    }

    /// The client of a request that [`authorize`] has let through.
    ///
    /// # Errors
    /// [`Error::Internal`] for a route without [`authorize`].
    pub fn from_extensions(extensions: &Extensions) -> Result<Self, Error> {
        let caller = extensions.get::<Self>().cloned();
        caller.ok_or_else(|| Error::Internal("a route without authorisation".into()))
    }

    fn anonymous(class: RequestClass) -> Self {
        Self {
            holder: "anonymous".into(),
            name: None,
            scopes: vec![Scope::Admin],
            robots: None,
            session_sha256: None,
            class,
        }
    }

    /// Whether the key has this scope.
    pub fn has(&self, scope: Scope) -> bool {
        self.scopes.contains(&scope) || self.scopes.contains(&Scope::Admin)
    }

    /// Whether the key may see this robot. Otherwise everything of the robot answers 404.
    pub fn may_see(&self, robot_id: &str) -> bool {
        self.robots
            .as_ref()
            .is_none_or(|robots| robots.iter().any(|id| id == robot_id))
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
pub async fn authorize(
    State((app, routes)): State<(App, &'static [Route])>,
    mut request: Request,
    next: Next,
) -> Response {
    let template = request
        .extensions()
        .get::<MatchedPath>()
        .map(|path| path.as_str().to_owned());
    let (method, headers) = (request.method().clone(), request.headers().clone());
    let peer = request.extensions().get::<Peer>().copied();
    let admitted = match template {
        Some(template) => {
            let of_path = routes.iter().filter(|route| route.path == template);
            authorized_caller(&app, of_path, &method, &headers, peer).await
        }
        // The router answers 404 to a path without a route.
        None => Ok(Caller::anonymous(RequestClass::Read)),
    };
    match admitted {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(Refusal::Error(error)) => {
            let forget = matches!(error, Error::Unauthorized(_))
                && session_cookie::token(&headers).is_some();
            let mut response = error.into_response();
            if forget {
                let cookie = session_cookie::sign_out_cookie(&app, &headers);
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

async fn authorized_caller(
    app: &App,
    of_path: impl Iterator<Item = &Route> + Clone,
    method: &Method,
    headers: &HeaderMap,
    peer: Option<Peer>,
) -> Result<Caller, Refusal> {
    let route = of_path.clone().find(|route| route.matches_method(method));
    let class = route.map_or(RequestClass::Read, |route| route.class);
    // A path may have a public route and one that needs a key. A method that the path does not take needs a key unless the path has a public route.
    let is_public = match route {
        Some(route) => route.scope.is_none(),
        None => of_path.clone().any(|route| route.scope.is_none()),
    };
    if is_public {
        return Ok(Caller::anonymous(class));
    }
    let caller = if app.no_auth {
        Caller::anonymous(class)
    } else {
        authenticate(app, class, method, headers, peer)
            .await
            .map_err(Refusal::Error)?
    };
    app.limits
        .count_request(&caller.holder)
        .map_err(Refusal::Error)?;
    match route.and_then(|route| route.scope) {
        Some(scope) if caller.has(scope) => Ok(caller),
        Some(scope) => Err(Refusal::Error(Error::InsufficientScope {
            scope: scope.as_str(),
            what: "this route",
        })),
        None => Err(Refusal::Method(allowed_methods(of_path))),
    }
}

fn allowed_methods<'r>(of_path: impl Iterator<Item = &'r Route>) -> String {
    let methods: Vec<&str> = of_path
        .map(|route| match route.method {
            Method::GET => "GET,HEAD",
            _ => route.method.as_str(),
        })
        .collect();
    methods.join(",")
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

async fn authenticate(
    app: &App,
    class: RequestClass,
    method: &Method,
    headers: &HeaderMap,
    peer: Option<Peer>,
) -> Result<Caller, Error> {
    let (row, session_sha256, refusal) = if let Some(key) = bearer(headers)? {
        let sha256 = canonical::sha256_hex(key.as_bytes());
        (
            api_keys::find(&app.store, &sha256).await?,
            None,
            UNKNOWN_KEY,
        )
    } else if let Some(token) = session_cookie::checked_token(method, headers)? {
        let sha256 = canonical::sha256_hex(token.as_bytes());
        let row = browser_sessions::find(&app.store, &sha256).await?;
        (row, Some(sha256), SESSION_ENDED)
    } else {
        return Err(Error::Unauthorized(
            "a key is needed: send `Authorization: Bearer KEY`; `kincal key create` makes one",
        ));
    };
    match row {
        Some(row) => Caller::new(row, session_sha256, class),
        None => Err(app
            .limits
            .count_failed_attempt(peer.map(|peer| peer.0))
            .err()
            .unwrap_or(Error::Unauthorized(refusal))),
    }
}

/// Whether the key, or the session, of a long request is still valid; false if the database cannot be read.
pub async fn is_still_valid(app: &App, caller: &Caller) -> bool {
    if app.no_auth {
        return true;
    }
    if let Some(sha256) = &caller.session_sha256 {
        let found = browser_sessions::find(&app.store, sha256).await;
        return found.is_ok_and(|row| row.is_some());
    }
    let row = api_keys::get(&app.store, &caller.holder).await;
    row.is_ok_and(|row| row.revoked_at_ms.is_none())
}

/// A secret that was just made: a key, or the token of a session.
pub struct NewSecret {
    /// Its text, which is shown once.
    pub text: String,
    /// Its hash, which is stored.
    pub sha256: String,
}

/// Makes a key.
pub fn new_key() -> Result<NewSecret, Error> {
    new_secret(KEY_PREFIX)
}

/// Makes the token of a session.
pub fn new_token() -> Result<NewSecret, Error> {
    new_secret("")
}

fn new_secret(prefix: &str) -> Result<NewSecret, Error> {
    let mut random = [0_u8; RANDOM_BYTES];
    getrandom::fill(&mut random)
        .map_err(|error| Error::Internal(format!("no random numbers: {error}")))?;
    let text = format!("{prefix}{}", canonical::hex(&random));
    let sha256 = canonical::sha256_hex(text.as_bytes());
    Ok(NewSecret { text, sha256 })
}
