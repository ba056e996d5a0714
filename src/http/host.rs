//! Checks `Host`, and with `--no-auth` also `Origin`. Any page in a browser on the same machine can reach a server without keys, by DNS
//! rebinding or a cross-site request. A server with keys needs no check of the origin: no browser sends a key by itself, and `session_cookie`
//! checks requests with a session.

use crate::http::extract::media_type;
use crate::http::headers::{IDEMPOTENCY_KEY, SEC_FETCH_SITE};
use crate::http::{App, Error};
use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{Ipv4Addr, Ipv6Addr};

const SEC_FETCH_MODE: HeaderName = HeaderName::from_static("sec-fetch-mode");

/// Content types that a page may send to any site without a preflight request (Fetch standard, CORS-safelisted request headers).
const SAFELISTED_CONTENT_TYPES: [&str; 3] = [
    "text/plain",
    "application/x-www-form-urlencoded",
    "multipart/form-data",
];

/// Refuses requests without a valid `Host`, and with `--no-auth` those to other hosts and those from pages of other sites. Applies to every path.
pub async fn check(State(app): State<App>, request: Request, next: Next) -> Response {
    let checked = host(&request).and_then(|host| {
        if app.no_auth {
            loopback_only(&request, host.as_ref())
        } else {
            Ok(())
        }
    });
    match checked {
        Ok(()) => next.run(request).await,
        Err(error) => error.into_response(),
    }
}

/// The request's host. HTTP/1.0 allows requests without one (RFC 9112, section 3.2); no browser sends them.
fn host(request: &Request) -> Result<Option<Authority>, Error> {
    let refused = |code, detail: &str| Err(Error::bad_request(code, detail));
    let mut values = request.headers().get_all(header::HOST).iter();
    match (values.next(), values.next()) {
        (_, Some(_)) => refused(
            "repeated_host",
            "the request has more than one Host header; send one",
        ),
        (None, None) if request.version() == Version::HTTP_10 => Ok(None),
        (None, None) => refused(
            "missing_host",
            "the request has no Host header, which HTTP/1.1 demands: send `Host: ` and the server's name",
        ),
        (Some(value), None) => match Authority::try_from(value.as_bytes()) {
            Ok(authority) if is_host_and_port(&authority) => Ok(Some(authority)),
            _ => refused(
                "invalid_host",
                "the Host header is not a host name or address, with or without a port",
            ),
        },
    }
}

/// Whether the authority consists of a host and an optional port only. [`Authority`] alone would accept `127.0.0.1:80.evil.example` as the
/// host 127.0.0.1.
fn is_host_and_port(authority: &Authority) -> bool {
    let behind = authority.as_str().strip_prefix(authority.host());
    let is_port = |port: &str| {
        port.bytes().all(|byte| byte.is_ascii_digit())
            && (port.is_empty() || port.parse::<u16>().is_ok())
    };
    behind.is_some_and(|text| text.is_empty() || text.strip_prefix(':').is_some_and(is_port))
}

/// Checks a request to a server with `--no-auth`.
fn loopback_only(request: &Request, host: Option<&Authority>) -> Result<(), Error> {
    // Health checks of a proxy may have no `Host`. Requests that change something must have one.
    let is_read = matches!(
        *request.method(),
        Method::GET | Method::HEAD | Method::OPTIONS
    );
    if host.is_none() && !is_read {
        let detail = "the request has no Host header: send `Host: localhost` and the port";
        return Err(Error::bad_request("missing_host", detail));
    }
    // In absolute form, the request target contains a host too: `GET http://host/path`.
    if let Some(other) = host
        .into_iter()
        .chain(request.uri().authority())
        .find(|host| !is_loopback(host.host()))
    {
        return Err(Error::HostNotLoopback(
            other.as_str().chars().take(100).collect(),
        ));
    }
    let headers = request.headers();
    let mut origins = headers.get_all(header::ORIGIN).iter();
    if let Some(origin) = origins.find(|origin| !is_same_origin(origin, host)) {
        let origin = String::from_utf8_lossy(origin.as_bytes());
        return Err(Error::ForeignOrigin(format!(
            "the request comes from a page of {:?}",
            origin.chars().take(100).collect::<String>()
        )));
    }
    if is_cross_site(request.method(), headers) {
        return Err(Error::ForeignOrigin(
            "the request comes from a page of another site".into(),
        ));
    }
    let may_be_a_form = request.method() == Method::POST
        && media_type(headers)
            .is_some_and(|kind| SAFELISTED_CONTENT_TYPES.contains(&kind.as_str()));
    if may_be_a_form
        && !headers.contains_key(header::ORIGIN)
        && !headers.contains_key(SEC_FETCH_SITE)
        && !headers.contains_key(IDEMPOTENCY_KEY)
    {
        return Err(Error::UnsupportedMediaType {
            found: media_type(headers).unwrap_or_default(),
            expected: "the body's own type, such as application/json, text/csv or application/xml, or a form with an Idempotency-Key: a \
                       form of another site could send this body, and this server takes no keys",
        });
    }
    Ok(())
}

/// `localhost`, 127.0.0.0/8 and `[::1]`.
fn is_loopback(host: &str) -> bool {
    let ipv6 = host
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'));
    host.eq_ignore_ascii_case("localhost")
        || host.parse().is_ok_and(|ip: Ipv4Addr| ip.is_loopback())
        || ipv6.is_some_and(|ip| ip.parse().is_ok_and(|ip: Ipv6Addr| ip.is_loopback()))
}

/// Whether an origin is this server, under the request's host.
fn is_same_origin(origin: &HeaderValue, host: Option<&Authority>) -> bool {
    let origin = origin.to_str().ok();
    let authority = origin.and_then(|text| {
        text.strip_prefix("http://")
            .or_else(|| text.strip_prefix("https://"))
    });
    authority
        .zip(host)
        .is_some_and(|(origin, host)| origin.eq_ignore_ascii_case(host.as_str()))
}

/// Whether the browser declares the request as cross-site (Fetch Metadata). A followed link is allowed.
fn is_cross_site(method: &Method, headers: &HeaderMap) -> bool {
    let is = |name: &HeaderName, values: &[&str]| {
        headers
            .get(name)
            .is_some_and(|value| values.iter().any(|known| value == known))
    };
    let is_link =
        matches!(*method, Method::GET | Method::HEAD) && is(&SEC_FETCH_MODE, &["navigate"]);
    headers.contains_key(SEC_FETCH_SITE)
        && !is(&SEC_FETCH_SITE, &["same-origin", "none"])
        && !is_link
}

#[cfg(test)]
mod tests {
    use super::{is_host_and_port, is_loopback};

    #[test]
    fn only_a_port_stands_behind_a_host() {
        for (text, expected) in [
            ("localhost", true),
            ("localhost:80", true),
            ("127.0.0.1:65535", true),
            ("[::1]:8080", true),
            ("[::1]", true),
            ("127.0.0.1:80.evil.example", false),
            ("127.0.0.1:evil", false),
            ("127.0.0.1:65536", false),
            ("[::1].evil.example", false),
            ("[::1].evil.example:80", false),
            ("localhost:+80", false),
            ("somebody@localhost", false),
        ] {
            let is_one = text.parse().is_ok_and(|parsed| is_host_and_port(&parsed));
            assert_eq!(is_one, expected, "{text}");
        }
    }

    #[test]
    fn only_loopback_names_and_addresses_are_loopback() {
        for host in [
            "localhost",
            "LocalHost",
            "127.0.0.1",
            "127.8.9.10",
            "[::1]",
            "[0:0:0:0:0:0:0:1]",
        ] {
            assert!(is_loopback(host), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.nip.io",
            "127.0.0.1.",
            "0.0.0.0",
            "128.0.0.1",
            "2130706433",
            "::1",
            "[::]",
            "[::ffff:127.0.0.1]",
            "",
        ] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
