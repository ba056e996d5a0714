//! Headers that several files read.

use axum::http::{HeaderMap, HeaderName, header};

/// The browser's statement whether the request comes from this origin or from another one (Fetch Metadata).
pub const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
/// The client's key for a request that it may retry. A form of a web page cannot send this header.
pub const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// Whether the client has the content with this ETag already (`If-None-Match`, RFC 9110, section 13.1.2).
pub fn matches_etag(headers: &HeaderMap, etag: &str) -> bool {
    let known = headers
        .get(header::IF_NONE_MATCH)
        .and_then(|value| value.to_str().ok())
        .unwrap_or_default();
    known
        .split(',')
        .any(|tag| tag.trim() == "*" || tag.trim().trim_start_matches("W/") == etag)
}
