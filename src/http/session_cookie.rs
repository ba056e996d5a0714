//! The cookie of a signed-in browser, so that links and new tabs stay signed in.
//!
//! Its value is the key itself. Any other value that the server can check would have to follow from the database; anybody with a copy of the database
//! could then forge it. The cookie is `HttpOnly`: no script reads it. It is sent to `/v1` only. It ends with the browser, with sign-out, or with the
//! revocation of the key.
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

/// The key in the request's cookie; `None` without one.
///
/// # Errors
/// [`Error::Forbidden`] if the request may come from a page of another origin.
pub fn key_of<'a>(method: &Method, headers: &'a HeaderMap) -> Result<Option<&'a str>, Error> {
    let Some(key) = cookie(headers) else {
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
    Ok(Some(key))
}

/// Whether the request has the cookie, valid or not.
pub fn is_present(headers: &HeaderMap) -> bool {
    cookie(headers).is_some()
}

fn cookie(headers: &HeaderMap) -> Option<&str> {
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

/// The header that signs a browser in; `None` for a text that cannot be the value of a cookie. Every key can be.
pub fn signing_in(key: &str, app: &App, headers: &HeaderMap) -> Option<HeaderValue> {
    let is_plain = key
        .bytes()
        .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
    is_plain
        .then(|| HeaderValue::from_str(&with_attributes(key, "", is_secure(app, headers))).ok())
        .flatten()
}

/// The header that signs a browser out.
pub fn signing_out(app: &App, headers: &HeaderMap) -> Option<HeaderValue> {
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
