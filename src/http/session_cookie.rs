//! The cookie of a signed-in browser, so that links and new tabs stay signed in.
//!
//! Its value is a random token. The database has only the token's SHA-256 and the id of the key, so a copy of the database does not give
//! access, and every node accepts the cookie. The key is looked up at each request. The cookie is `HttpOnly`: no script reads it. It is
//! sent to `/v1` only. The session ends when the user signs out, when the key is revoked, or at its maximum age
//! ([`crate::store::browser_sessions::MAX_AGE_MS`]). The browser deletes the cookie when it closes.
//!
//! Browsers send cookies by themselves, so a page of another origin could use one. Three things prevent this: `SameSite=Strict`; the header
//! [`SESSION_HEADER`] on every request that changes something (a page of another origin needs a preflight request for this header, and the server
//! refuses it); and `Sec-Fetch-Site`, if the browser sends it.

use crate::http::headers::SEC_FETCH_SITE;
use crate::http::{App, Error};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, header};

/// Name of the cookie.
pub const SESSION_COOKIE: &str = "kincal_session";
/// Header that a request with the cookie needs if it changes something; any value.
pub const SESSION_HEADER: HeaderName = HeaderName::from_static("x-kincal-session");

/// Maximum number of cookies that are read from one request; a browser sends a handful.
const MAX_COOKIES: usize = 64;

/// The token in the request's cookie; `None` without one.
///
/// # Errors
/// [`Error::Forbidden`] if the request may come from a page of another origin.
pub fn checked_token<'a>(
    method: &Method,
    headers: &'a HeaderMap,
) -> Result<Option<&'a str>, Error> {
    let Some(token) = token(headers) else {
        return Ok(None);
    };
    let is_foreign = headers
        .get(SEC_FETCH_SITE)
        .is_some_and(|site| site != "same-origin" && site != "none");
    if is_foreign {
        return Err(Error::Forbidden(
            "the request comes from a page of another origin, which must not use the session of this browser: open the dashboard itself",
        ));
    }
    let is_safe = matches!(*method, Method::GET | Method::HEAD);
    if !is_safe && !headers.contains_key(SESSION_HEADER) {
        return Err(Error::Forbidden(
            "a request with a session cookie that changes something needs the header `X-Kincal-Session: 1`; programs send `Authorization: Bearer KEY` instead",
        ));
    }
    Ok(Some(token))
}

/// The value of the cookie, not checked. [`checked_token`] refuses requests from pages of other origins.
pub fn token(headers: &HeaderMap) -> Option<&str> {
    headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|text| text.split(';'))
        .take(MAX_COOKIES)
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(name, value)| *name == SESSION_COOKIE && !value.is_empty())
        .map(|(_, value)| value)
}

/// The header that signs a browser in.
pub fn sign_in_cookie(token: &str, app: &App, headers: &HeaderMap) -> Option<HeaderValue> {
    HeaderValue::from_str(&with_attributes(token, "", is_secure(app, headers))).ok()
}

/// The header that signs a browser out.
pub fn sign_out_cookie(app: &App, headers: &HeaderMap) -> Option<HeaderValue> {
    HeaderValue::from_str(&with_attributes("", "; Max-Age=0", is_secure(app, headers))).ok()
}

/// Whether the browser came by TLS: to this server, or to a proxy in front of it.
fn is_secure(app: &App, headers: &HeaderMap) -> bool {
    app.has_tls
        || headers
            .get(header::ORIGIN)
            .is_some_and(|origin| origin.as_bytes().starts_with(b"https://"))
}

fn with_attributes(value: &str, more: &str, is_secure: bool) -> String {
    let secure = if is_secure { "; Secure" } else { "" };
    format!("{SESSION_COOKIE}={value}; Path=/v1; HttpOnly; SameSite=Strict{secure}{more}")
}
