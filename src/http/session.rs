//! Who sends a request: the permissions of its key, and signing a browser in and out.

use crate::http::auth::{Caller, bearer, new_token};
use crate::http::session_cookie::{self, sign_in_cookie, sign_out_cookie};
use crate::http::{App, Error};
use crate::store::{Tx, browser_sessions};
use crate::wire::canonical;
use crate::wire::key::KeyAnswer;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Signs this browser in with the key of the request.
///
/// The answer sets a cookie that scripts cannot read. With it, links and new tabs need no `Authorization` header; requests that change
/// something need the header `X-Kincal-Session: 1`. The session ends with the browser, with sign-out, with the revocation of the key, or after 12 hours.
#[utoipa::path(put, path = "/v1/session", tag = "service", operation_id = "signIn", responses((status = 204, description = "Signed in; the answer sets the cookie")))]
pub async fn sign_in(
    State(app): State<App>,
    caller: Caller,
    headers: HeaderMap,
) -> Result<Response, Error> {
    // With `--no-auth`, or if the browser is signed in by its cookie, no session is needed.
    if app.no_auth || bearer(&headers)?.is_none() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let _permit = app.limits.write_permit()?;
    let token = new_token()?;
    let mut tx = app.store.begin().await?;
    // `begin` comes first: it deletes all ended sessions. If each request deleted its own session first, two requests with ended sessions
    // could deadlock.
    browser_sessions::begin(&mut tx, &token.sha256, &caller.holder).await?;
    end_session(&mut tx, &headers).await?;
    tx.commit().await?;
    let cookie = sign_in_cookie(&token.text, &app, &headers);
    Ok((
        StatusCode::NO_CONTENT,
        cookie_header(cookie),
        [(header::CACHE_CONTROL, "no-store")],
    )
        .into_response())
}

/// Signs this browser out: its session ends, and the answer deletes the cookie, also where the session could not be ended.
#[utoipa::path(delete, path = "/v1/session", tag = "service", operation_id = "signOut", responses((status = 204, description = "Signed out")))]
pub async fn sign_out(State(app): State<App>, _caller: Caller, headers: HeaderMap) -> Response {
    let ended = async {
        let _permit = app.limits.write_permit()?;
        let mut tx = app.store.begin().await?;
        end_session(&mut tx, &headers).await?;
        Ok::<(), Error>(tx.commit().await?)
    };
    let mut response = match ended.await {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(error) => error.into_response(),
    };
    let cookie = cookie_header(sign_out_cookie(&app, &headers));
    response.headers_mut().extend(cookie);
    response
}

/// Ends the session of the request's cookie, if it has one.
async fn end_session(tx: &mut Tx, headers: &HeaderMap) -> Result<(), Error> {
    if let Some(token) = session_cookie::token(headers) {
        browser_sessions::end(tx, &canonical::sha256_hex(token.as_bytes())).await?;
    }
    Ok(())
}

fn cookie_header(value: Option<header::HeaderValue>) -> HeaderMap {
    value
        .into_iter()
        .map(|value| (header::SET_COOKIE, value))
        .collect()
}

/// Permissions of this request's key.
#[utoipa::path(get, path = "/v1/me", tag = "service", operation_id = "getMe", responses((status = 200, description = "The key", body = KeyAnswer)))]
pub async fn me(caller: Caller) -> Result<Json<KeyAnswer>, Error> {
    Ok(Json(KeyAnswer {
        id: caller.holder,
        name: caller.name,
        scopes: caller.scopes,
        robots: caller.robots,
    }))
}
