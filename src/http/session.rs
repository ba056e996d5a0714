//! Signing a browser in and out.

use crate::http::auth::{Caller, bearer};
use crate::http::session_cookie::{signing_in, signing_out};
use crate::http::{App, Error};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Signs this browser in with the key of the request.
///
/// The answer sets a cookie that scripts cannot read. With it, links and new tabs need no `Authorization` header; requests that change
/// something need the header `X-Kincal-Session: 1`. The session ends with the browser, with sign-out, or with the revocation of the key.
#[utoipa::path(put, path = "/v1/session", tag = "service", operation_id = "signIn", responses((status = 204, description = "Signed in; the answer sets the cookie")))]
pub async fn sign_in(
    State(app): State<App>,
    _caller: Caller,
    headers: HeaderMap,
) -> Result<Response, Error> {
    // Signed in already, or no keys at all: there is nothing to set.
    let Some(key) = bearer(&headers)? else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    let cookie = signing_in(key, &app, &headers);
    Ok((
        StatusCode::NO_CONTENT,
        cookie_header(cookie),
        [(header::CACHE_CONTROL, "no-store")],
    )
        .into_response())
}

/// Signs this browser out: the answer deletes the cookie.
#[utoipa::path(delete, path = "/v1/session", tag = "service", operation_id = "signOut", responses((status = 204, description = "Signed out")))]
pub async fn sign_out(State(app): State<App>, _caller: Caller, headers: HeaderMap) -> Response {
    let cookie = signing_out(&app, &headers);
    (StatusCode::NO_CONTENT, cookie_header(cookie)).into_response()
}

fn cookie_header(value: Option<header::HeaderValue>) -> HeaderMap {
    value
        .into_iter()
        .map(|value| (header::SET_COOKIE, value))
        .collect()
}
